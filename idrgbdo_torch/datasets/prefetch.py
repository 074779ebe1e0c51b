"""Reads ahead in threads while the reader works, in order. Decoders run without Python's lock, so both overlap."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

AHEAD = 8  # frames that are decoded, or being decoded, before they are asked for; 27 MB at 640x480
MOST_THREADS = 4  # the PNGs of a frame take several times as long to decode as the frame to track

T = TypeVar("T")
Key = TypeVar("Key")


def decoding_threads() -> int:
    """How many threads decode: one core is left to the tracker, so that its times are its own."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(MOST_THREADS, usable - 1))


def prefetch(
    read: Callable[[Key], T], keys: Iterable[Key], *, threads: int | None = None, ahead: int = AHEAD
) -> Iterator[T]:
    """read(key) of every key, in the order of the keys, at most `ahead` of them called before they are asked for.

    read is called in `threads` threads (decoding_threads() by default), so it must allow that. An exception that it
    raises comes out in the place of its key, and ends the iteration. Reading begins with the first item asked for;
    closing the iterator, or dropping it, ends the threads: what has not begun is not read any more.
    """
    pending: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(min(threads or decoding_threads(), ahead), thread_name_prefix="prefetch")
    try:
        for key in keys:
            pending.append(pool.submit(read, key))
            if len(pending) >= ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
