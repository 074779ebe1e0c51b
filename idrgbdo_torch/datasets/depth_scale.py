"""How many depth values make a metre, and which value means that nothing was measured; doubts about both."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

USUAL_M = (0.5, 4.5)  # median of what a hand-held depth camera looks at
POSSIBLE_M = (0.05, 30.0)  # median that some depth camera can have
# what cameras and data sets store, values per metre; the common ones first
COMMON = {
    1.0: "metres",
    1000.0: "millimetres",
    4000.0: "RealSense L515",
    5000.0: "TUM",
    10000.0: "RealSense D405",
}
RARE = {6553.5: "Replica", 256.0: "KITTI, VOID", 100.0: "centimetres"}
CLOSE_RANGE = (4000.0, 10000.0)  # nobody's default: whoever states them has a camera for short distances
SATURATED = 65535  # some cameras write it for "no depth"

FAR_SHARE = 0.002  # of an image's pixels, that a constant for "no depth" takes at least
FAR_GAP = 0.8  # times the constant: no measured value is beyond


@dataclass(frozen=True)
class ScaleDoubt:
    """A depth scale that makes an unusual median depth."""

    wrong: bool  # rather than only unusual, as in a close-range scan
    advice: str


@dataclass(frozen=True)
class DepthReading:
    """How a recording's raw depth becomes metres."""

    scale: float  # values per metre
    unknown: float | None  # raw value that stands for "no depth" besides 0
    warnings: list[str]


def scale_doubt(median_m: float, scale: float) -> ScaleDoubt | None:
    """What speaks against `scale` (values per metre) where it makes the median depth `median_m`; None if nothing.

    A scan at 0.2 m is no fault. It is one where another scale that is common would make the depth usual.
    """
    if _usual(median_m) or (scale == 1.0 and POSSIBLE_M[0] <= median_m <= USUAL_M[1]):
        return None
    raw = median_m * scale
    likely = {s: name for s, name in {**COMMON, **RARE}.items() if s != scale and _usual(raw / s)}
    common = any(s in COMMON for s in likely)
    close = median_m < USUAL_M[0]
    possible = POSSIBLE_M[0] <= median_m <= POSSIBLE_M[1]
    wrong = not possible or (common and not (close and scale in CLOSE_RANGE))
    view = "close-range scan" if close else "view into the distance"
    believed = "" if wrong else f"a {view}? then nothing is wrong; else "
    if not likely:
        return ScaleDoubt(wrong, f"{believed}pass the right --depth-scale")
    options = ", ".join(f"{raw / s:.2g} m with {s:g} ({name})" for s, name in sorted(likely.items()))
    return ScaleDoubt(
        wrong, f"{believed}the raw median {raw:.0f} is {options}: pass that of your camera with --depth-scale"
    )


def depth_warnings(depth: NDArray[Any], depth_scale: float, unknown: float | None = None) -> list[str]:
    """A sentence for the user where the first frame's raw depth cannot be right, or is unusual."""
    valid = _measured(depth, unknown)
    if len(valid) == 0:
        return ["the first frame has no valid depth at all; check that the depth images are the right ones"]
    median = float(np.median(valid)) / depth_scale
    doubt = scale_doubt(median, depth_scale)
    if doubt is None:
        return []
    return [f"depth scale {depth_scale:g} makes the first frame's median depth {median:.3g} m; {doubt.advice}"]


def depth_reading(
    first: NDArray[Any],
    later: Callable[[], Iterable[NDArray[Any]]],
    asked: float | None,
    in_file: float | None,
    usual: float,
) -> DepthReading:
    """The scale and the value of unknown depth of a recording, with warnings.

    first, later: (h, w) raw depth of the first frame, and of some others, read only where they are needed. asked: the
    scale that the user passed, which counts before that of the camera file, `in_file`, before the format's usual one.
    Floats are metres where nobody says otherwise, and also where the camera file's scale would make dust of them.
    """
    unknown = far_constant(first, later)
    warnings = []
    if unknown is not None:
        warnings.append(
            f"depth of exactly {unknown:g} stands alone, far behind everything else, in all images looked at; it is "
            "taken for unknown"
        )
    floats = np.issubdtype(first.dtype, np.floating)
    scale = asked or in_file or (1.0 if floats else usual)
    if floats and asked is None and in_file not in (None, 1.0):
        valid = _measured(first, unknown)
        median = float(np.median(valid)) if len(valid) else 0.0
        if median / scale < POSSIBLE_M[0] <= median <= POSSIBLE_M[1]:
            warnings.append(
                f"depth is floats around {median:.2g}, read as metres; the camera file's depth_scale of {scale:g} is "
                "for whole numbers: correct it to 1"
            )
            scale = 1.0
    return DepthReading(scale, unknown, [*warnings, *depth_warnings(first, scale, unknown)])


def far_constant(first: NDArray[Any], later: Callable[[], Iterable[NDArray[Any]]]) -> float | None:
    """The raw value with which holes were filled, if they were: the largest in all images, and nothing near it.

    A wall that the camera moves along could be meant, too; but then depth would not end so far before it.
    """
    value = _lonely_maximum(first)
    if value is None:
        return None
    others = list(later())
    maxima = [_lonely_maximum(depth) for depth in others]
    agreed = value in maxima and all(m == value or not _reaches(d, value) for m, d in zip(maxima, others, strict=True))
    moved = any(d.shape != first.shape or bool(((d != first) & (d != value) & (first != value)).any()) for d in others)
    return value if agreed and moved else None


def _lonely_maximum(depth: NDArray[Any]) -> float | None:
    valid = depth[_valid(depth)]
    if len(valid) == 0:
        return None
    top = valid.max()
    below = valid[valid < top]
    alone = len(below) > 0 and float(below.max()) < FAR_GAP * float(top)
    return float(top) if alone and len(valid) - len(below) >= FAR_SHARE * depth.size else None


def _reaches(depth: NDArray[Any], value: float) -> bool:
    return bool((depth[_valid(depth)] >= FAR_GAP * value).any())


def _measured(depth: NDArray[Any], unknown: float | None) -> NDArray[Any]:
    valid = depth[_valid(depth)]
    return valid if unknown is None else valid[valid != unknown]


def _valid(depth: NDArray[Any]) -> NDArray[np.bool_]:
    known: NDArray[np.bool_] = np.isfinite(depth) & (depth > 0)
    if depth.dtype.kind in "iu":
        known &= np.not_equal(depth, SATURATED) & np.not_equal(depth, np.iinfo(depth.dtype).max)
    return known


def _usual(metres: float) -> bool:
    return USUAL_M[0] <= metres <= USUAL_M[1]
