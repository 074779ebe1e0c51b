"""Which colour image and which depth image make a frame, by what their names say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import IdRgbdoError
from .midnight import day_beside
from .name_times import OF_DAY, Times, long_gap, set_back, ticks_in, times_in
from .names import Names, numbers_in, read_names, repeated
from .number_steps import tick_gap
from .pairing import FPS, MOST_ALONE, alone_warning, own_counts_warning, pair_by_time, share_alone

LIST = "or list the pairs, lines `time colour time depth`, and pass the list with --associations"
IN_SECONDS = f"if they are milliseconds, name the images by seconds, {LIST}"

LARGEST_NUMBER = 10**8  # of a frame: a month of them; what is larger counts something else, and only its order is used

Frame = tuple[float, Path, Path]  # s, colour, depth
Numbers = tuple[list[list[int]], list[list[int]]]  # that may stand for the frame, in colour's names and in depth's


@dataclass(frozen=True)
class Paired:
    """The frames of two folders of images."""

    frames: list[Frame]  # by time
    numbers: list[int]  # of the frames: those in their names, or their places
    all_numbers: list[int]  # of all images, those without partner included, increasing
    how: str  # they were paired, for people
    warnings: tuple[str, ...] = ()


def pair_by_names(
    color: Sequence[Path], depth: Sequence[Path], where: Path, fps: float | None = None, limit_s: float = 0.02
) -> Paired:
    """Pair images by the times in their names, else by number, else in their order.

    fps: frames per second, where the names are no times. limit_s: between the two images of a frame.
    Raises IdRgbdoError, saying what was tried, where numbers repeat or more than a tenth are left without partner.
    """
    names = read_names(color), read_names(depth)
    strays = _stray_warning(names)
    tried: list[str] = []
    read = _of_one_night(times_in(names[0]), times_in(names[1]))
    times = _going_on(names[0], read[0], tried), _going_on(names[1], read[1], tried)
    numbers = numbers_in(names[0], _columns(read[0])), numbers_in(names[1], _columns(read[1]))
    clock = tuple(f"{reason}; the frames are taken by their numbers" for reason in tried)
    paired = (
        _by_time(names, times, where, limit_s, tried)
        or _by_number(names, numbers, times[0], fps or FPS, tried)
        or _by_time(names, (ticks_in(names[0]), ticks_in(names[1])), where, limit_s, tried)
        or (_in_order(color, depth, names, fps or FPS) if all(t is None for t in times) else None)
    )
    if paired is None:
        raise IdRgbdoError(
            f"sequence: cannot tell which colour and which depth images of '{where}' belong together, e.g. "
            f"'{color[0].name}' and '{depth[0].name}'; tried {'; '.join(tried)}. Give the two images of a frame the "
            f"same number or time as their names, e.g. 000000.png, {LIST}"
        )
    return replace(paired, warnings=(*strays, *clock, *_seconds_warning(times[0]), *paired.warnings))


def _columns(times: Times | None) -> tuple[int, ...]:
    return times.columns if times else ()


def _of_one_night(color: Times | None, depth: Times | None) -> tuple[Times | None, Times | None]:
    """Times of day of colour and depth of which one kind may begin after midnight, or end before."""
    if not (color and depth and color.kind.startswith(OF_DAY) and depth.kind.startswith(OF_DAY)):
        return color, depth
    later = day_beside(color.seconds, depth.seconds), day_beside(depth.seconds, color.seconds)
    return replace(color, seconds=later[0]), replace(depth, seconds=later[1])


def _going_on(names: Names, times: Times | None, tried: list[str]) -> Times | None:
    """The times in the names, where they go on as the numbers do."""
    back = set_back(names, times) if times else None
    if back is None:
        return times
    tried.append(f"the times in the names run backwards at '{back.parent.name}/{back.name}' while the numbers go on")
    return None


def _stray_warning(names: tuple[Names, Names]) -> tuple[str, ...]:
    strays = [path for of_one in names for path in of_one.strays]
    if not strays:
        return ()
    shown = ", ".join(f"{path.parent.name}/{path.name}" for path in strays[:3])
    more = f" and {len(strays) - 3} more" if len(strays) > 3 else ""
    return (f"left out, since named unlike the other images: {shown}{more}",)


def _seconds_warning(times: Times | None) -> tuple[str, ...]:
    gap = long_gap(times) if times else None
    return () if gap is None else (f"the times in the names are {gap:g} apart and are taken as seconds; {IN_SECONDS}",)


def _ticks_warning(numbers: Sequence[int], fps: float) -> tuple[str, ...]:
    gap = tick_gap(numbers)
    if gap is None:
        return ()
    return (
        f"the numbers in the names are about {gap:g} apart and are taken as the numbers of frames, {fps:g} a second; "
        f"{IN_SECONDS}",
    )


def _by_time(
    names: tuple[Names, Names], times: tuple[Times | None, Times | None], where: Path, limit_s: float, tried: list[str]
) -> Paired | None:
    """The nearest in time, where nearly all have a partner."""
    of_color, of_depth = times
    if of_color is None or of_depth is None:
        return None
    kinds = of_color.kind if of_color.kind == of_depth.kind else f"{of_color.kind}; {of_depth.kind}"
    color, depth = (
        sorted(zip(t.seconds, of_one.files, strict=True)) for t, of_one in zip((of_color, of_depth), names, strict=True)
    )
    try:
        frames = pair_by_time(color, depth, limit_s, where)
    except IdRgbdoError as error:
        tried.append(f"the times in their names ({kinds}): {_reason(error)}")
        return None
    stamps = [t for t, _ in color], [t for t, _ in depth]
    if share_alone(*stamps, len(frames)) > MOST_ALONE:
        tried.append(
            f"the times in their names ({kinds}): only {len(frames)} of {min(map(len, stamps))} are within "
            f"{limit_s:g} s of each other"
        )
        return None
    used = {path for _, *files in frames for path in files}
    alone = [path for of_one in (color, depth) for _, path in of_one if path not in used]
    place = {path: number for number, (_, path) in enumerate(color)}
    numbers = [place[path] for _, path, _ in frames]
    said = alone_warning(alone, f"within {limit_s:g} s")
    return Paired(frames, numbers, list(place.values()), f"paired by the times in their names ({kinds})", said)


def _reason(error: IdRgbdoError) -> str:
    return str(error).split("each other, ")[-1].split(";")[0]


def _by_number(
    names: tuple[Names, Names], numbers: Numbers, times: Times | None, fps: float, tried: list[str]
) -> Paired | None:
    """The same number, at the places in the names where most have a partner; their times by the colour's names."""
    choices = [(a, b) for a in numbers[0] for b in numbers[1]]
    unique = [(a, b) for a, b in choices if repeated(a) is None and repeated(b) is None]
    if choices and not unique and not times:
        _raise_repeated(names, numbers)
    if not unique:
        tried.append("their numbers: none beside the times that is another one in each name")
        return None
    a, b = max(unique, key=lambda choice: len(set(choice[0]) & set(choice[1])))  # the likeliest of those with most
    color, depth = (dict(sorted(zip(n, of_one.files, strict=True))) for n, of_one in zip((a, b), names, strict=True))
    common = [number for number in color if number in depth]
    if not common or share_alone(list(color), list(depth), len(common)) > MOST_ALONE:
        without = next((color[n].name for n in color if n not in depth), "")
        tried.append(
            f"their numbers: {len(common)} of {min(len(color), len(depth))} have a partner, not so '{without}'"
        )
        return None
    seconds = dict(zip(names[0].files, times.seconds, strict=True)) if times else {}
    places = common if max(common) < LARGEST_NUMBER else range(len(common))
    frames = sorted((seconds.get(color[n], place / fps), n) for n, place in zip(common, places, strict=True))
    alone = [path for of_one in (color, depth) for n, path in of_one.items() if not (n in color and n in depth)]
    counted = places is common and not times
    clock = f"times of the colour images' names ({times.kind})" if times else f"{fps:g} frames per second"
    return Paired(
        [(time, color[n], depth[n]) for time, n in frames],
        [n for _, n in frames],
        sorted({*color, *depth}),
        f"paired by number, {clock}",
        (
            *(_ticks_warning(common, fps) if counted else ()),
            *alone_warning(alone, "of the same number"),
            *own_counts_warning(list(color), list(depth)),
        ),
    )


def _raise_repeated(names: tuple[Names, Names], numbers: Numbers) -> None:
    """Raises IdRgbdoError with two names of a folder that have the same number."""
    for of_one, choices in zip(names, numbers, strict=True):
        for choice in choices:
            twice = repeated(choice)
            if twice is not None:
                first, second = (of_one.files[place] for place in twice)
                raise IdRgbdoError(
                    f"sequence: expected a number or a time of its own in each name, but '{first.name}' and "
                    f"'{second.name}' in '{first.parent}' have the same number, and no times were found; name the "
                    f"images 000000.png, 000001.png ..., {LIST}"
                )


def _in_order(color: Sequence[Path], depth: Sequence[Path], names: tuple[Names, Names], fps: float) -> Paired | None:
    """Side by side, where there are as many of each and no number is common to both.

    Raises IdRgbdoError where there are not as many of each, and no numbers either.
    """
    if any(set(a) & set(b) for a in numbers_in(names[0]) for b in numbers_in(names[1])):
        return None
    a, b = (list(of_one.files) or list(files) for of_one, files in zip(names, (color, depth), strict=True))
    if len(a) != len(b):
        if names[0].columns and names[1].columns:
            return None
        raise IdRgbdoError(
            f"sequence: cannot tell which of the {len(color)} images in '{color[0].parent}' belongs to which of the "
            f"{len(depth)} in '{depth[0].parent}'; give the two images of a frame the same number or time as their "
            "names, e.g. 000000.png"
        )
    frames = [(k / fps, *files) for k, files in enumerate(zip(a, b, strict=True))]
    places = list(range(len(frames)))
    return Paired(frames, places, places, f"paired in the order of their names, {fps:g} frames per second")
