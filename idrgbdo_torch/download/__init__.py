"""Public recordings, fetched and unpacked with care: nothing that a server or an archive says is believed."""

from __future__ import annotations

from .tum import BASE_URL, TUM_SEQUENCES, Progress, download_tum, long_name

__all__ = ["BASE_URL", "TUM_SEQUENCES", "Progress", "download_tum", "long_name"]
