"""The ratios that the package promises (ranges.json): `OMP_NUM_THREADS=1 pytest tests/benchmarks --gate`.

Each is measured in one process, its sides taking turns, and shown. Without --gate or --benchmark-enable everything runs
on tiny images and nothing has to be fast. Times are of the processor, of the thread that tracks.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from itertools import islice, pairwise
from pathlib import Path
from statistics import fmean, median

import pytest
from endless import back_and_forth
from rendered import Film

from baselines import METHODS
from idrgbdo_torch.datasets import RgbdSequence, open_sequence
from idrgbdo_torch.datasets.prefetch import decoding_threads
from idrgbdo_torch.experiments import cost, fig7, fig8
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Odometry, run
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.synthetic.sequence import write_tum as write_folder
from idrgbdo_torch.tracker import id_rgbdo
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo

LIBRARIES = [name for name in METHODS if name.startswith(("open3d", "opencv"))]
Show = Callable[[str], None]
Ratio = Callable[[str, float], None]


def track_ms(odometry: Odometry, frame: RgbdFrame) -> tuple[float, bool]:
    """Processor time of one frame, and whether it became a keyframe."""
    begin = time.thread_time_ns()
    result = odometry.track(frame)
    return (time.thread_time_ns() - begin) / 1e6, result.keyframe


def test_a_frame_costs_little_beside_the_libraries(full: bool, footage: Film, show: Show, ratio: Ratio) -> None:
    """Median 40 times, mean with keyframes 15 times below the fastest library's median, on the same frames.

    Everyone tracks neighbouring frames, the libraries some of ours in their turn. What a library does in threads of its
    own is not counted against it.
    """
    turn, block = (60, 12) if full else (4, 3)
    frames = list(islice(back_and_forth(footage.frames), 4 * turn))
    ours = IdRgbdo()
    others = {name: METHODS[name].make(0) for name in LIBRARIES}
    times: list[float] = []
    theirs: dict[str, list[float]] = {name: [] for name in others}
    for end in range(turn, len(frames) + 1, turn):
        times += [track_ms(ours, frame)[0] for frame in frames[end - turn : end]]
        for name, odometry in others.items():
            theirs[name] += [track_ms(odometry, frame)[0] for frame in frames[end - block : end]][1:]
    medians = {name: median(each) for name, each in theirs.items()}
    fastest = min(medians, key=medians.__getitem__)
    typical, mean = median(times[2:]), fmean(times[2:])
    show(f"a frame: median {typical:.2f} ms, mean {mean:.2f} ms; {fastest} {medians[fastest]:.1f} ms")
    ratio("frame: the fastest library's median over ours", medians[fastest] / typical)
    ratio("frame: the fastest library's median over our mean", medians[fastest] / mean)


def test_tracking_grows_with_the_points(full: bool, shrink: int, ratio: Ratio) -> None:
    """500 points cost 10 times as much as 24, linearly."""
    rows = fig7.survey(300, shrink=1) if full else fig7.survey(1, (24, 48), shrink)
    first, last = rows[0], rows[-1]
    fit = fig7.linear(rows, 1)[2]
    ratio("points: tracking 500 over 24", last[1] / first[1])
    ratio("points: R^2 of a straight line", fit)


def test_choosing_costs_less_than_half_of_tracking(
    full: bool, footage: Film, ratio: Ratio, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over a run with 24 points: points are chosen when the view has changed, and tracked in every frame."""
    spent = {"select_points": 0, "align": 0}

    def timed(name: str) -> None:
        function = getattr(id_rgbdo, name)

        def wrapper(*arguments: object, **named: object) -> object:
            begin = time.thread_time_ns()
            try:
                return function(*arguments, **named)
            finally:
                spent[name] += time.thread_time_ns() - begin

        monkeypatch.setattr(id_rgbdo, name, wrapper)

    odometry = IdRgbdo()
    for name in spent:
        timed(name)
    for frame in islice(back_and_forth(footage.frames), 240 if full else 4):
        odometry.track(frame)
    ratio("points: choosing 24 over tracking them", spent["select_points"] / spent["align"])


def test_the_window_grows_with_points_and_keyframes(full: bool, shrink: int, show: Show, ratio: Ratio) -> None:
    """500 points a keyframe cost 10 times as much as 24; an iteration no more than points times keyframes squared."""
    keyframes = cost.KEYFRAMES if full else (3, 4)
    rows = fig8.survey(9, (24, 500), keyframes) if full else fig8.survey(1, (24, 48), keyframes, shrink)
    ms = {(row[0], row[1]): row[2] for row in rows}
    each = {(row[0], row[1]): row[2] / max(row[3], 1) for row in rows}
    few, many = rows[0][0], rows[-1][0]
    usual = 8 if full else 4
    growth = [each[many, b] / each[many, a] / (b / a) ** 2 for a, b in pairwise(keyframes)]
    ratio("window: 500 points over 24", ms[many, usual] / ms[few, usual])
    show(f"an iteration over keyframes squared, from size to size: {', '.join(f'{g:.2f}' for g in growth)}")
    ratio("window: an iteration over keyframes squared, largest growth", max(growth))


def test_nothing_grows_along_a_sequence(full: bool, footage: Film, show: Show, ratio: Ratio) -> None:
    """The last 500 of 3000 frames take as long as the first within 5 %, keyframes too; memory stays within 20 MB.

    A new odometry tracks its first frames in turns with the old one's last, the same images, so that both times are
    of the same minute; memory is taken before that.
    """
    part = 500 if full else 10
    turn = 2 * len(footage.frames) - 2  # frames after which the images come again
    old, new = IdRgbdo(), IdRgbdo()
    frames = back_and_forth(footage.frames)
    resident = 0.0
    for number in range((2500 if full else 20) // turn * turn):
        old.track(next(frames))
        if number == part:
            resident = resident_mb()
    memory = resident_mb() - resident
    first: dict[bool, list[float]] = {False: [], True: []}
    last: dict[bool, list[float]] = {False: [], True: []}
    early = back_and_forth(footage.frames)
    for frame in islice(early, turn):  # until its window is full: the first keyframes have less to refine
        new.track(frame)
    for frame, later in zip(islice(early, part), frames, strict=False):
        for odometry, image, times in ((new, frame, first), (old, later, last)):
            ms, keyframe = track_ms(odometry, image)
            times[keyframe].append(ms)
    growth = {kind: median(last[kind]) / median(first[kind]) for kind in first if first[kind] and last[kind]}
    rates = ", ".join(f"a {'keyframe' if kind else 'frame'} {rate:.3f}" for kind, rate in growth.items())
    show(f"after {len(old.history.times)} frames {rates} of what it cost at first, memory {memory:+.1f} MB")
    ratio("length: a frame or keyframe after 2500 over one at first", max(growth.values()))
    ratio("length: MB more after 2500 frames", memory)


def test_a_run_is_as_fast_as_decoding(full: bool, tmp_path: Path, show: Show, ratio: Ratio) -> None:
    """Tracking 300 frames of PNG and writing the results: at least 0.85 of the rate of decoding alone."""
    small = SynthConfig(frames=4, width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5)
    sequence = lengthened(SynthConfig(frames=60) if full else small, 300 if full else 8, tmp_path / "film")
    rates: list[tuple[float, ...]] = []
    for turn in range(3 if full else 1):
        begin, busy = time.perf_counter(), time.process_time()
        assert sum(isinstance(frame, RgbdFrame) for frame in sequence) == len(sequence)
        decoded, between = time.perf_counter(), time.process_time()
        with RunFolder(tmp_path / str(turn)) as folder:
            odometry = IdRgbdo()
            folder.finish(run(odometry, sequence, folder.append), odometry)
        tracked, end = time.perf_counter(), time.process_time()
        spans = (decoded - begin, tracked - decoded, between - busy, end - between)
        rates.append(tuple(1000 * span / len(sequence) for span in spans))
    decoding, running, *busy_ms = (median(each) for each in zip(*rates, strict=True))
    show(f"decoding {decoding:.1f}, a run {running:.1f} ms a frame")
    ratio("run: its rate over that of decoding", decoding / running)
    show(f"of the processor {busy_ms[0]:.1f} and {busy_ms[1]:.1f} ms, {decoding_threads()} decoding threads")


def lengthened(config: SynthConfig, frames: int, folder: Path) -> RgbdSequence:
    """A rendered sequence on disk, its files listed forwards, backwards, and so on."""
    write_folder(RenderedSequence(config), folder)
    for kind in ("rgb", "depth"):
        lines = [line for line in (folder / f"{kind}.txt").read_text().splitlines() if not line.startswith("#")]
        names = [line.split()[1] for line in lines]
        turn: Sequence[str] = [*names, *names[-2:0:-1]]
        listed = (f"{number / 30:.6f} {turn[number % len(turn)]}\n" for number in range(frames))
        (folder / f"{kind}.txt").write_text("".join(listed))
    return open_sequence(folder)


def resident_mb() -> float:
    """Memory of this process."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
