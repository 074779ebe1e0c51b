"""What people look at: one HTML file that needs no network, for a run and for a comparison."""

from __future__ import annotations

from .comparison_page import comparison_page
from .run_page import run_page
from .snapshots import Snapshot, watch

__all__ = ["Snapshot", "comparison_page", "run_page", "watch"]
