"""How every kernel is compiled: serial, cached on disk, without the lock, with C's division."""

from __future__ import annotations

from functools import partial

from numba import njit

# nan and infinity keep their meaning, since failures are recognised by them; sums may be regrouped for SIMD
kernel = partial(njit, cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
