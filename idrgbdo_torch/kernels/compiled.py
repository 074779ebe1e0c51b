"""How every kernel is compiled: serial, cached on disk, without the lock, with C's division."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit

# of all kernels and what they share: the cache only looks at a kernel's own file, and would keep it when one that it
# calls has changed
HERE = Path(__file__).parent
FILES = [path for path in (*sorted(HERE.glob("*.py")), HERE.parent / "measurement.py") if path.exists()]
SOURCES = sha256(b"".join(path.read_bytes() for path in FILES)).hexdigest()[:8]


def kernel(function: Callable[..., Any]) -> Any:
    """Compile when first called; kept beside this file, else in the user's cache, or in $NUMBA_CACHE_DIR if it is set.

    Where none of them can be written, every process compiles anew.
    """
    # nan and infinity keep their meaning, since failures are recognised by them; sums may be regrouped for SIMD
    return _compiled(function, {"contract", "reassoc", "arcp", "nsz"})


def exact_kernel(function: Callable[..., Any]) -> Any:
    """As `kernel`, but every operation rounds as written: the same bits on every processor, and those of numpy."""
    return _compiled(function, False)


def _compiled(function: Callable[..., Any], fastmath: set[str] | bool) -> Any:
    function.__qualname__ = f"{function.__qualname__}_{SOURCES}"  # it names the files in the cache
    # nothing calls them from C, and that wrapper is a tenth of the compilation
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "fastmath": fastmath}
    try:
        return njit(function, cache=True, **options)
    except RuntimeError:  # "no locator available": nowhere to keep it
        return njit(function, **options)
