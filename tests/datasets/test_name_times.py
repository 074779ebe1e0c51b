"""Times and numbers in names that look like each other: milliseconds all different, ticks from 0 on, picked frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from idrgbdo_torch.datasets.by_name import Paired, pair_by_names
from idrgbdo_torch.errors import IdRgbdoError

START_S = 1_704_110_400  # 2024-01-01 12:00:00
Name = Callable[[int, float], str]  # of the frame of a number and a time in seconds


def pair(color: list[str], depth: list[str], **options: float) -> Paired:
    """The names' files need not exist: only their names are read."""
    folders = [Path("take") / kind for kind in ("rgb", "depth")]
    files = [sorted(folder / name for name in names) for folder, names in zip(folders, (color, depth), strict=True)]
    return pair_by_names(*files, where=Path("take"), **options)


def written(name: Name, fps: float, frames: int = 60) -> list[str]:
    return [name(k, k / fps) for k in range(frames)]


def shown(paired: Paired) -> list[str]:
    return [color.name for _, color, _ in paired.frames]


def two_parts(seconds: float, start: int = 0) -> str:
    ms = round(1000 * seconds)
    return f"{start + ms // 1000}_{ms % 1000:03}"


BROADCAST: dict[str, tuple[Name, float]] = {  # how the names are written, and the time of the first
    "SECS.mmm": (lambda k, s: f"{START_S + s:.3f}.png", START_S),
    "SECS_mmm": (lambda k, s: f"{two_parts(s, START_S)}.png", START_S),
    "date and ms": (lambda k, s: f"20240101_1200{s:06.3f}".replace(".", "_") + ".png", START_S),
    "counter and date": (lambda k, s: f"{k}_2024-01-01T12-00-{s:06.3f}.png", START_S),
    "counter and seconds": (lambda k, s: f"frame{k:05}_{s:.3f}.png", 0),
    "counter that is not padded": (lambda k, s: f"frame{k}_{s:.3f}s.png", 0),
    "counter behind": (lambda k, s: f"{s:.3f}_frame{k}.png", 0),
    "every tenth": (lambda k, s: f"frame{10 * k:05}_{two_parts(s)}.png", 0),
    "prefix": (lambda k, s: f"rgb_{s:.3f}.png", 0),
    "two clocks": (lambda k, s: f"{two_parts(s, START_S)}_{two_parts(s + 0.2, START_S)}.png", START_S),
}


@pytest.mark.parametrize("fps", [29.97, 23.976, 14.985])
@pytest.mark.parametrize("kind", BROADCAST)
def test_milliseconds_that_are_all_different_count_no_frames(kind: str, fps: float) -> None:
    name, first = BROADCAST[kind]
    names = written(name, fps)
    paired = pair(names, names)
    assert shown(paired) == names
    assert [time for time, _, _ in paired.frames] == pytest.approx([first + k / fps for k in range(60)], abs=1.01e-3)
    assert (paired.how.split(" (")[0], paired.warnings) == ("paired by the times in their names", ())


def test_a_part_of_a_second_pairs_nothing_where_the_clocks_differ() -> None:
    """Steps of 33 ms: the same milliseconds come back in other seconds, and would pair those."""
    color = written(lambda k, s: f"{two_parts(s, START_S)}.png", 1000 / 33, 900)
    depth = written(lambda k, s: f"{two_parts(s + 330 * 0.033, START_S + 100)}.png", 1000 / 33, 900)
    with pytest.raises(IdRgbdoError, match=r"tried the times in their names .* their numbers: none beside the times"):
        pair(color, depth)


def test_the_counter_is_the_number_where_the_clock_was_set_back() -> None:
    names = written(lambda k, s: f"frame{k}_{two_parts(s - (3600 if k > 40 else 0), START_S)}.png", 29.97)
    paired = pair(names, names)
    assert (shown(paired), paired.numbers) == (names, list(range(60)))
    assert f"the times in the names run backwards at 'rgb/{names[41]}'" in paired.warnings[0]


def test_two_decimals_behind_a_counter_are_not_the_number() -> None:
    names = written(lambda k, s: f"frame{k}_{s:.2f}.png", 29.97, 25)
    paired = pair(names, names)
    assert (shown(paired), paired.numbers) == (names, list(range(25)))


FROM_ZERO: dict[str, Name] = {  # at 29.97 Hz, and at 25 Hz, where the steps are even
    "microseconds": lambda k, s: f"{1e6 * s:.0f}.png",
    "microseconds with decimals": lambda k, s: f"{1e6 * s:.3f}.png",
    "nanoseconds": lambda k, s: f"img_{1e9 * s:.0f}.png",
    "milliseconds beside a counter": lambda k, s: f"img_{k:04}_{1e3 * s:.3f}.png",
}


@pytest.mark.parametrize("fps", [29.97, 25])
@pytest.mark.parametrize("kind", FROM_ZERO)
def test_times_from_a_start_are_read_where_they_can_be_no_numbers_of_frames(kind: str, fps: float) -> None:
    names = written(FROM_ZERO[kind], fps, 24)
    paired = pair(names, names)
    assert shown(paired) == names
    assert [time for time, _, _ in paired.frames] == pytest.approx([k / fps for k in range(24)], abs=1.01e-3)
    assert paired.warnings == ()


def test_decimals_of_less_than_a_second_are_a_time() -> None:
    names = written(lambda k, s: f"rgb_{s:.3f}.png", 29.97, 24)
    paired = pair(names, names)
    assert [time for time, _, _ in paired.frames] == pytest.approx([k / 29.97 for k in range(24)], abs=1.01e-3)
    assert paired.warnings == ()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            lambda k, s: f"{1e3 * s:.0f}.png",
            "the numbers in the names are about 33 apart and are taken as the numbers of",
        ),
        (lambda k, s: f"t{1e3 * s + 5e6:.0f}.png", "the numbers in the names are about 33 apart"),
        (lambda k, s: f"{1e3 * s:.3f}.png", "the times in the names are 33.367 apart and are taken as seconds"),
        (lambda k, s: f"rgb_{1e3 * s:.3f}.png", "the times in the names are 33.367 apart and are taken as seconds"),
    ],
)
def test_what_may_be_milliseconds_is_a_warning(name: Name, said: str) -> None:
    names = written(name, 29.97)
    (warning,) = pair(names, names).warnings
    assert warning.startswith(said)
    assert "if they are milliseconds, name the images by seconds, or list the pairs" in warning


@pytest.mark.parametrize(
    "numbers",
    [
        range(0, 600, 10),
        [k for k in range(0, 600, 10) if k % 70],  # every tenth, some missing
        [k * k for k in range(60)],
        [0, 9, 31, 44, 70, 81, 120, 133, 139, 166],  # picked by their views
        [7],
    ],
)
@pytest.mark.parametrize("layout", ["{:06}.png", "cam0.{:06}.png", "take_0.{:03}.png"])
def test_picked_frames_are_no_times(layout: str, numbers: list[int]) -> None:
    names = [layout.format(number) for number in numbers]
    paired = pair(names, names)
    assert (paired.numbers, paired.warnings) == (list(numbers), ())
    assert [time for time, _, _ in paired.frames] == pytest.approx([number / 30 for number in numbers])


def test_seconds_since_1970_may_be_far_apart() -> None:
    names = [f"{START_S + 33.367 * k:.3f}.png" for k in range(20)]
    assert pair(names, names).warnings == ()


def time_of_day(k: int, seconds: float) -> str:
    ms = (24 * 3600 - 1) * 1000 + round(1000 * seconds)  # from a second before midnight on
    return f"{ms // 3_600_000 % 24:02}-{ms // 60_000 % 60:02}-{ms // 1000 % 60:02}.{ms % 1000:03}.png"


@pytest.mark.parametrize(("color", "depth"), [((0, 60), (0, 60)), ((20, 60), (31, 60)), ((20, 34), (20, 29))])
def test_times_of_day_go_on_over_midnight(color: tuple[int, int], depth: tuple[int, int]) -> None:
    """Though one kind begins after midnight, or ends before."""
    names = written(time_of_day, 29.97)
    paired = pair(names[slice(*color)], names[slice(*depth)])
    assert shown(paired) == names[max(color[0], depth[0]) : min(color[1], depth[1])]
    times = [time for time, _, _ in paired.frames]
    assert [after - before for before, after in pairwise(times)] == pytest.approx(
        [1 / 29.97] * (len(times) - 1), abs=2e-3
    )


def disordered(k: int, most: int) -> int:
    return 617283 * (k + 1) % most


@pytest.mark.parametrize(
    "name",
    [
        lambda k: f"{k:04}_{disordered(k, 10**6)}.png",  # an id, a size in bytes, a checksum
        lambda k: f"img{k:05}_crc{1000 + disordered(k, 8999)}.png",
        lambda k: f"{k:05}_{18000 + round(15000 * math.sin(k / 8)) + k % 7}.png",  # an angle
        lambda k: f"cam{k % 3}_{k:03}.png",
        lambda k: f"grade{k * 7 % 4}_{k:03}.png",
        lambda k: f"room{1 if k < 20 or k > 39 else 2}_{5 * k:03}.png",
        lambda k: f"room_{1 if k < 20 or k > 39 else 2}.{50 * k:04}.png",
        lambda k: f"take_1.{31 * k + k % 3:04}.png",
    ],
)
def test_frames_stay_in_the_order_of_their_numbers_beside_others(name: Callable[[int], str]) -> None:
    names = [name(k) for k in range(60)]
    paired = pair(names, names)
    assert shown(paired) == names
    assert paired.how.startswith("paired by number")
