"""Reading ahead: in order, bounded, errors in their place, and no thread is left behind."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.prefetch import prefetch
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import ConstantVelocity, Status, run


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    yield
    assert [thread.name for thread in threading.enumerate() if thread.name.startswith("prefetch")] == []


@pytest.mark.parametrize(("threads", "ahead"), [(1, 1), (1, 4), (2, 2), (4, 8)])
def test_the_order_is_that_of_the_keys_however_long_each_takes(threads: int, ahead: int) -> None:
    rng = np.random.default_rng(0)
    naps = 0.003 * rng.random(40)

    def read(number: int) -> int:
        time.sleep(naps[number])
        return number

    assert list(prefetch(read, range(40), threads=threads, ahead=ahead)) == list(range(40))


def test_never_more_than_ahead_are_begun_before_they_are_asked_for() -> None:
    begun: list[int] = []
    items = prefetch(lambda number: begun.append(number) or number, count(), threads=2, ahead=3)
    assert not begun  # nothing is asked for yet
    for number in range(10):
        assert next(items) == number
        time.sleep(0.01)  # time enough to read further, if it were allowed
        assert len(begun) <= number + 3
    items.close()  # type: ignore[attr-defined]
    assert len(begun) < 14


def test_it_reads_on_while_the_reader_works() -> None:
    waited = threading.Event()
    items = prefetch(lambda number: number == 1 and waited.set(), range(4), threads=1, ahead=2)
    next(items)
    assert waited.wait(5.0)  # the second is read although only the first was asked for
    assert len(list(items)) == 3


def test_an_error_comes_in_its_place() -> None:
    def read(number: int) -> int:
        if number == 3:
            raise ValueError("the fourth is broken")
        return number

    items = prefetch(read, range(10), threads=2)
    assert list(islice(items, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="the fourth"):
        next(items)
    assert list(items) == []


def test_an_error_of_the_reader_ends_the_threads() -> None:
    with pytest.raises(RuntimeError, match="tracker"):
        for number in prefetch(lambda number: number, count(), threads=2):
            if number == 5:
                raise RuntimeError("tracker")


SCRIPT = """
import signal
import time
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may have it ignored
from itertools import count
from idrgbdo_torch.datasets.prefetch import prefetch
items = prefetch(lambda number: time.sleep(0.01) or number, count(), threads=2)
for number in items:
    print(number, flush=True)
    {body}
"""


@pytest.mark.parametrize("body", ["raise RuntimeError('tracker')", "kept = items; break", "time.sleep(60)"])
def test_a_process_ends_at_an_error_at_a_break_and_at_ctrl_c(body: str) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(body=body)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "0\n"
    if "sleep" in body:
        process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert (process.returncode == 0) == ("break" in body)
    assert ("RuntimeError: tracker" if "raise" in body else "KeyboardInterrupt" if "sleep" in body else "") in errors


def test_a_recording_is_the_same_ahead_as_frame_by_frame(make_recording: Callable[..., Path]) -> None:
    folder = make_recording()
    sequence = open_sequence(folder)
    broken = sorted((folder / "depth").iterdir())[2]
    broken.write_bytes(broken.read_bytes()[:-30])
    ahead, one_by_one = list(sequence), [sequence.read(number) for number in range(len(sequence))]
    assert [type(frame) for frame in ahead] == [type(frame) for frame in one_by_one]
    assert isinstance(ahead[2], BrokenFrame)
    assert "truncated" in ahead[2].reason
    for a, b in zip(ahead, one_by_one, strict=True):
        assert a.timestamp == b.timestamp
        if isinstance(a, RgbdFrame) and isinstance(b, RgbdFrame):
            assert a.gray.equal(b.gray)
            assert a.depth.equal(b.depth)
    done = run(ConstantVelocity(), sequence)
    assert [number for number, status in enumerate(done.statuses) if status is Status.LOST] == [2]
