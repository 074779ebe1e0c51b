"""Names of images as people's programs write them: times are read as times, numbers as numbers, strays are named."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from idrgbdo_torch.datasets.by_name import Paired, pair_by_names
from idrgbdo_torch.errors import IdRgbdoError

FRAMES = 75
START_NS = 1_612_345_678_500_000_000
STEP_NS = 33_333_333
Name = Callable[[int, int], str]  # of the frame of a number and a time in nanoseconds


def date(ns: int, layout: str) -> str:
    return datetime.fromtimestamp(ns // 10**9, UTC).strftime(layout)


def pair(color: list[str], depth: list[str], **options: float) -> Paired:
    """The names' files need not exist: only their names are read."""
    folders = [Path("take") / kind for kind in ("rgb", "depth")]
    files = [sorted(folder / name for name in names) for folder, names in zip(folders, (color, depth), strict=True)]
    return pair_by_names(*files, where=Path("take"), **options)


def written(name: Name, start_ns: int = START_NS) -> list[str]:
    return [name(k, start_ns + k * STEP_NS) for k in range(FRAMES)]


TIMES: dict[str, tuple[Name, float]] = {  # how the names are written, and what part of a second they hold
    "secs_nsecs": (lambda k, ns: f"{ns // 10**9}_{ns % 10**9}.png", 1e-9),
    "secs_nsecs padded": (lambda k, ns: f"{ns // 10**9}_{ns % 10**9:09}.png", 1e-9),
    "secs-nsecs": (lambda k, ns: f"{ns // 10**9}-{ns % 10**9}.jpg", 1e-9),
    "secs.nsecs of printf": (lambda k, ns: f"{ns // 10**9}.{ns % 10**9}.png", 1e-9),
    "secs.decimals": (lambda k, ns: f"{ns / 1e9:.6f}".rstrip("0").rstrip(".") + ".png", 1e-6),
    "secs_usecs": (lambda k, ns: f"{ns // 10**9}_{ns % 10**9 // 1000:06}.png", 1e-6),
    "secs_msecs": (lambda k, ns: f"{ns // 10**9}_{ns % 10**9 // 10**6}.png", 1e-3),
    "with a counter": (lambda k, ns: f"frame{k:04}_{ns // 10**9}_{ns % 10**9}.png", 1e-9),
    "with the size": (lambda k, ns: f"{ns // 10**9}_{ns % 10**9:09}_640x480.png", 1e-9),
    "with a camera": (lambda k, ns: f"cam0_{ns // 10**9}_{ns % 10**9:09}.png", 1e-9),
    "counter_nanoseconds": (lambda k, ns: f"{k:06}_{ns}.png", 1e-9),
    "milliseconds_counter": (lambda k, ns: f"{ns // 10**6}-{k}.png", 1e-3),
    "microseconds": (lambda k, ns: f"img{ns // 1000}.png", 1e-6),
    "date_time-ms": (lambda k, ns: date(ns, "%Y-%m-%d_%H-%M-%S-") + f"{ns % 10**9 // 10**6:03}.png", 1e-3),
    "date, ms not padded": (lambda k, ns: date(ns, "%Y-%m-%d_%H-%M-%S-") + f"{ns % 10**9 // 10**6}.png", 1e-3),
    "compact date": (lambda k, ns: date(ns, "rgb_%Y%m%d_%H%M%S_") + f"{ns % 10**9 // 1000:06}.png", 1e-6),
    "ISO date": (lambda k, ns: date(ns, "%Y-%m-%dT%H:%M:%S.") + f"{ns % 10**9 // 1000:06}Z.png", 1e-6),
    "one number of digits": (lambda k, ns: date(ns, "%Y%m%d%H%M%S") + f"{ns % 10**9 // 10**6:03}.png", 1e-3),
}


@pytest.mark.parametrize("kind", TIMES)
def test_times_in_names_are_the_times_of_the_frames(kind: str) -> None:
    name, resolution = TIMES[kind]
    paired = pair(written(name), written(name))
    expected = [(START_NS + k * STEP_NS) / 1e9 for k in range(FRAMES)]
    assert len(paired.frames) == FRAMES
    assert [(a.name, b.name) for _, a, b in paired.frames] == [(n, n) for n in written(name)]  # none out of order
    assert [time for time, _, _ in paired.frames] == pytest.approx(expected, abs=1.01 * resolution + 3e-7)
    assert (paired.how.split(" (")[0], paired.warnings) == ("paired by the times in their names", ())


@pytest.mark.parametrize(
    ("name", "per_second"),
    [
        (lambda k, ns: f"{k + 1:07}-{(ns - START_NS) // 1000:012}.jpg", 1e6),  # SUN3D
        (lambda k, ns: f"{k + 1}_{(ns - START_NS) // 10**6}.png", 1e3),
        (lambda k, ns: f"frame_{k}_t{ns - START_NS + 5 * 10**12}.png", 1e9),  # since the machine was started
    ],
)
def test_a_clock_beside_a_counter_pairs_though_the_counters_differ(name: Name, per_second: float) -> None:
    color, depth = written(name), written(lambda k, ns: name(k + 3, ns + 6_000_000))
    paired = pair(color, depth)
    times = [time for time, _, _ in paired.frames]
    assert len(times) == FRAMES
    assert np.diff(times) == pytest.approx(STEP_NS / 1e9, abs=1.01 / per_second)
    assert [(color.index(a.name), depth.index(b.name)) for _, a, b in paired.frames] == [(k, k) for k in range(FRAMES)]


def test_a_short_take_within_one_second() -> None:
    names = [f"1612345678_{ns}.png" for ns in (5_000_000, 38_333_333, 71_666_666)]
    assert [time for time, _, _ in pair(names, names).frames] == pytest.approx(
        [1612345678.005, 1612345678.038333, 1612345678.071667], abs=1e-6
    )
    assert pair(names[:1], names[:1]).frames[0][0] == pytest.approx(1612345678.005, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        (lambda k, ns: f"{k:06}.png", range(FRAMES)),
        (lambda k, ns: f"color_{k}.png", range(FRAMES)),
        (lambda k, ns: f"scan2_{k:04}_640x480.png", range(FRAMES)),
        (lambda k, ns: f"20210203_{k:06}.png", range(FRAMES)),  # a date and a counter
        (lambda k, ns: f"2021-02-03_09-47-58_{k:03}.png", range(FRAMES)),  # when it began, and a counter
        (lambda k, ns: f"1612345678_{k:04}.png", range(FRAMES)),
        (lambda k, ns: f"frame.{k:06}.png", range(FRAMES)),
        (lambda k, ns: f"cam0.{k:06}.png", range(FRAMES)),
        (lambda k, ns: f"{10 * k:06}.png", range(0, 10 * FRAMES, 10)),  # every tenth
        (lambda k, ns: f"{k * k:05}.png", [k * k for k in range(FRAMES)]),  # picked frames
    ],
)
def test_numbers_in_names_are_numbers(name: Name, numbers: list[int]) -> None:
    paired = pair(written(name), written(name), fps=15)
    assert [time for time, _, _ in paired.frames] == pytest.approx([number / 15 for number in numbers])
    assert paired.numbers == list(numbers)
    assert paired.how == "paired by number, 15 frames per second"


@pytest.mark.parametrize("stray", ["thumbnail.png", "000012 (copy).png", "000012(1).png", "Screenshot 2021-02-03.png"])
@pytest.mark.parametrize("kind", ["secs_nsecs", "date_time-ms", "number"])
def test_a_stray_file_is_named_and_costs_nothing_else(stray: str, kind: str) -> None:
    name = TIMES[kind][0] if kind in TIMES else lambda k, ns: f"{k:06}.png"
    clean = pair(written(name), written(name))
    paired = pair([*written(name), stray], written(name))
    assert (paired.frames, paired.how) == (clean.frames, clean.how)
    (warning,) = paired.warnings
    assert warning == f"left out, since named unlike the other images: rgb/{stray}"


def test_times_of_colour_and_numbers_of_depth() -> None:
    """Depth knows only the counter: the frames have the times of the colour images."""
    paired = pair(written(TIMES["counter_nanoseconds"][0]), written(lambda k, ns: f"depth_{k}.png"))
    assert [time for time, _, _ in paired.frames] == pytest.approx(
        [(START_NS + k * STEP_NS) / 1e9 for k in range(FRAMES)], abs=3e-7
    )
    assert paired.how == "paired by number, times of the colour images' names (nanoseconds)"


def test_two_clocks_that_differ_pair_by_their_counters() -> None:
    name = TIMES["counter_nanoseconds"][0]
    paired = pair(written(name), written(name, START_NS + 7 * 10**9))
    assert [int(a.name[:6]) - int(b.name[:6]) for _, a, b in paired.frames] == [0] * FRAMES
    assert paired.frames[0][0] == pytest.approx(START_NS / 1e9, abs=3e-7)


def test_depth_at_half_the_rate_is_no_fault_and_depth_that_starts_late_neither() -> None:
    names = written(TIMES["secs_nsecs"][0])
    for fewer in (names[::2], names[20:]):
        paired = pair(names, fewer)
        assert len(paired.frames) == len(fewer)
        (warning,) = paired.warnings
        assert f"{FRAMES - len(fewer)} images have no partner within 0.02 s and are left out" in warning
        assert len(pair([f"{k}.png" for k in range(FRAMES)], [f"{k}.png" for k in range(20, FRAMES)]).frames) == 55


@pytest.mark.parametrize(("colors", "depths", "said"), [(70, 35, "twice"), (35, 71, "twice"), (90, 29, "3 times")])
def test_kinds_that_count_on_their_own_are_doubted(colors: int, depths: int, said: str) -> None:
    paired = pair([f"{k:06}.png" for k in range(colors)], [f"{k:06}.png" for k in range(depths)])
    assert len(paired.frames) == min(colors, depths)
    more, fewer = ("colour", "depth") if colors > depths else ("depth", "colour")
    assert f"there are {said} as many {more} as {fewer} images, both counted from 0 on" in paired.warnings[1]
    assert "pass the list with --associations" in paired.warnings[1]


def test_one_count_of_both_kinds_is_not_doubted() -> None:
    numbers = [f"{k:06}.png" for k in range(70)]
    for fewer in (numbers[::2], numbers[35:], numbers[:50], numbers[:4]):
        assert len(pair(numbers, fewer).warnings) == 1
    assert len(pair(numbers[:8], numbers[:4]).warnings) == 1  # too few to tell
    assert pair(numbers, numbers).warnings == ()


def test_numbers_that_repeat_are_an_error_with_two_names() -> None:
    names = [f"{side}_{k:04}.png" for k in range(20) for side in ("left", "right")]
    with pytest.raises(
        IdRgbdoError, match=r"'left_0000\.png' and 'right_0000\.png' in 'take/rgb' have the same number"
    ):
        pair(names, [f"{k:04}.png" for k in range(20)])
    parts = [f"{part}_{k:02}.png" for part in range(2) for k in range(10)]
    with pytest.raises(IdRgbdoError, match=r"'0_00\.png' and '1_00\.png' in 'take/rgb' have the same number"):
        pair(parts, parts)


def test_seconds_that_repeat_are_no_times() -> None:
    names = [f"2021-02-03_09-47-{k // 4:02}_{'abcd'[k % 4]}.png" for k in range(40)]
    with pytest.raises(IdRgbdoError, match="have the same number, and no times were found"):
        pair(names, names)


def test_more_than_a_tenth_without_partner_is_an_error_that_says_what_was_tried() -> None:
    numbers = [f"{k:06}.png" for k in range(100)]
    with pytest.raises(IdRgbdoError) as caught:
        pair([n for k, n in enumerate(numbers) if k % 5], [n for k, n in enumerate(numbers) if k % 5 != 2])
    message = str(caught.value)
    tried = "tried their numbers: 60 of 80 have a partner, not so '000002.png'"
    for part in ("'000001.png' and '000000.png'", tried, "--associations"):
        assert part in message
    late = written(lambda k, ns: f"{ns // 10**9}_{ns % 10**9}.png", START_NS + 10**12 + 7)
    with pytest.raises(IdRgbdoError, match=r"tried the times in their names \(.*\): the closest two are 99\d\.\d+ s"):
        pair(written(TIMES["secs_nsecs"][0]), late)


def test_a_clock_that_was_set_back_does_not_put_frames_out_of_order() -> None:
    name = TIMES["counter_nanoseconds"][0]
    names = [name(k, START_NS + k * STEP_NS - (3600 * 10**9 if k >= 38 else 0)) for k in range(FRAMES)]
    paired = pair(names, names, fps=30)
    assert [a.name for _, a, _ in paired.frames] == names
    assert [time for time, _, _ in paired.frames] == pytest.approx([k / 30 for k in range(FRAMES)])
    said = f"the times in the names run backwards at 'rgb/{names[38]}' while the numbers go on; the frames are taken by"
    assert said in paired.warnings[0]


def test_numbers_too_large_for_frames_only_tell_their_order() -> None:
    names = written(lambda k, ns: f"{637_479_424_785_000_000 + k * 333_333}.png")  # 100 ns since the year 1
    paired = pair(names, names, fps=10)
    assert [a.name for _, a, _ in paired.frames] == names
    assert [time for time, _, _ in paired.frames] == pytest.approx([k / 10 for k in range(FRAMES)])


@pytest.mark.parametrize(
    "kind", ["secs_nsecs", "secs.nsecs of printf", "secs.decimals", "secs_msecs", "date, ms not padded"]
)
def test_jitter_and_dropped_frames_do_not_change_the_reading(kind: str) -> None:
    name, resolution = TIMES[kind]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        gaps = rng.normal(1, 0.05, 60) * (1 + (rng.random(60) < 0.2) * rng.integers(1, 4, 60)) / rng.choice([5, 15, 30])
        times = [START_NS + int(1e9 * t) for t in np.cumsum(gaps)]
        names, late = ([name(k, ns + d) for k, ns in enumerate(times)] for d in (0, 3_000_000))
        paired = pair(names, late)
        assert [(a.name, b.name) for _, a, b in paired.frames] == list(zip(names, late, strict=True))
        assert [t for t, _, _ in paired.frames] == pytest.approx(
            [ns / 1e9 for ns in times], abs=1.01 * resolution + 3e-7
        )
