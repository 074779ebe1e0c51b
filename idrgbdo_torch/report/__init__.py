"""What people look at: one HTML file that needs no network, for a run and for a comparison."""

from __future__ import annotations

from .comparison_page import comparison_page
from .glimpses import Glimpse, watch
from .run_page import run_page

__all__ = ["Glimpse", "comparison_page", "run_page", "watch"]
