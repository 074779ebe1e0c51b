"""From measurements to verdicts: every threshold, and what to do about what lies beyond it.

The thresholds stand between what good recordings give (rendered and real) and what the same recordings give with the
fault put in; docs/check.md has both.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..datasets.depth_scale import USUAL_M, scale_doubt
from ..measurement import LEVELS
from .edges import CONTRAST, STRONG
from .findings import Finding, Verdict
from .judge_camera import camera_file
from .judge_scene import another_view, cut, moving, still

if TYPE_CHECKING:
    from .measured import Measured

MATCHED_NOTE, MATCHED_FAULT = 0.95, 0.75  # share of the shorter list that found its partner
MISSING_NOTE, MISSING_FAULT = 0.03, 0.15  # share of frames
LOW_RATE = 8.0  # frames per second
SMALL_WIDTH = 120  # px, of images in which a shift of a pixel is as much as those that matter
LEAST_SIDE = 2 ** (LEVELS - 1)  # px, of images that have a coarsest level to begin with
VALID_NOTE, VALID_FAULT = 0.4, 0.15  # share of pixels with depth
SCALE_LIMIT = 1.4  # ratio of ways, by the depth and by the reference
SCALE_PAIRS, SCALE_WAY_M = 3, 0.15  # that can tell it
SHIFT_NOTE, SHIFT_FAULT = 0.008, 0.016  # of the image's width
LATE_NOTE, LATE_FAULT_S = 0.75, 0.05  # frames; seconds
FOCAL_LIMIT = 0.09  # of its logarithm
CENTER_LIMIT = 0.06  # of the image's width
CALIBRATION_PAIRS, SIGMAS = 4, 4.0
CENTER_USUAL = 0.08  # of the image's width, from its middle
KEPT_NOTE, KEPT_FAULT = 0.6, 0.35  # share of corners found in the next frame
BLURRED_PX = 6.0  # width of strong edges
DARK, BRIGHT = 30.0, 225.0  # gray levels


def findings(measured: Measured) -> list[Finding]:
    """All rows, in the order in which one would look."""
    rows = (
        _matched(measured),
        _readable(measured),
        _rate(measured),
        _size(measured),
        _depth(measured),
        _scale(measured),
        _registration(measured),
        _offset(measured),
        _intrinsics(measured),
        _overlap(measured),
        cut(measured.tracks),
        still(measured.tracks),
        moving(measured.motions_apart),
        _blur(measured),
        _brightness(measured),
        _reference(measured),
    )
    found = [row for row in rows if row is not None]
    if any(row.verdict is Verdict.FAULT for row in found):
        return found  # what is small shows once that is mended
    seen = camera_file(measured.camera_seen, measured.camera)
    return [*found, seen] if seen else found


def _matched(m: Measured) -> Finding | None:
    if m.lists is None:
        return None
    least = min(m.lists.color, m.lists.depth)
    share = m.frames / least
    value = f"{m.frames} pairs of {m.lists.color} colour and {m.lists.depth} depth images"
    verdict = _graded(share, MATCHED_NOTE, MATCHED_FAULT, below=True)
    late = f"depth stamps are {m.lists.delay_s:+.3f} s from colour's"
    return Finding("matched frames", verdict, f"{value}, {late}", _unless_good(
        verdict, "many images find no partner in time: are both lists of the same clock? see --association-limit"
    ))  # fmt: skip


def _readable(m: Measured) -> Finding | None:
    if not m.broken:
        return None
    verdict = Verdict.FAULT if len(m.broken) > 0.1 * m.sampled else Verdict.NOTE
    value = f"{len(m.broken)} of {m.sampled} sampled frames cannot be read"
    return Finding("files", verdict, value, f"the first: {m.broken[0]}")


def _rate(m: Measured) -> Finding:
    t = m.timing
    if t is None:
        return Finding("frame rate", Verdict.UNKNOWN, f"{m.frames} frames", "too few frames to tell")
    rate = 1.0 / t.period_s
    value = f"{rate:.3g} frames/s, {100 * t.missing_share:.0f} % missing, longest gap {t.longest_s:.3f} s"
    verdict = _graded(t.missing_share, MISSING_NOTE, MISSING_FAULT, below=False)
    if verdict is not Verdict.GOOD:
        return Finding("frame rate", verdict, value, "frames were dropped: record to a faster disk, or less at once")
    if t.pauses_s:
        advice = "the recording pauses: after it the camera is found again where it sees a place that it knows"
        return Finding("frame rate", Verdict.NOTE, value, advice)
    if rate < LOW_RATE:
        return Finding("frame rate", Verdict.NOTE, value, "few frames a second: keep every frame if there are more")
    return Finding("frame rate", verdict, value)


def _size(m: Measured) -> Finding:
    c = m.camera
    away = max(abs(c.cx - (c.width - 1) / 2), abs(c.cy - (c.height - 1) / 2)) / c.width
    angle = 2 * math.degrees(math.atan(c.width / (2 * c.fx)))
    value = f"{c.width}x{c.height}, {angle:.0f} degrees wide, fx {c.fx:.1f} fy {c.fy:.1f} cx {c.cx:.1f} cy {c.cy:.1f}"
    if min(c.width, c.height) < LEAST_SIDE:
        advice = f"too small to be tracked: record images of at least {LEAST_SIDE}x{LEAST_SIDE} pixels"
        return Finding("size, camera", Verdict.FAULT, value, advice)
    if away > CENTER_USUAL:
        advice = "the principal point is far from the middle: are these the intrinsics of images of another size?"
        return Finding("size, camera", Verdict.NOTE, value, advice)
    return Finding("size, camera", Verdict.GOOD, value)


def _depth(m: Measured) -> Finding:
    valid = float(np.median([image.valid for image in m.images])) if m.images else 0.0
    low, _, high = _depth_range(m)
    verdict = _graded(valid, VALID_NOTE, VALID_FAULT, below=True)
    value = f"{100 * valid:.0f} % of the pixels have depth, 90 % of it from {low:.2f} to {high:.2f} m"
    advice = _unless_good(verdict, "too little depth: stay within the sensor's range, off glass, black and sunlight")
    return Finding("depth", verdict, value, advice)


def _scale(m: Measured) -> Finding:
    """By the reference where there is one that moves, else by what such cameras usually look at."""
    middle = _depth_range(m)[1]
    value = f"median depth {middle:.2f} m"
    motion = m.motion
    if motion and motion.scale and motion.scale_pairs >= SCALE_PAIRS and motion.scale_way_m >= SCALE_WAY_M:
        value += f", ways are {motion.scale:.2f} times the reference's"
        if 1.0 / SCALE_LIMIT < motion.scale < SCALE_LIMIT:
            return Finding("depth scale", Verdict.GOOD, value)
        return Finding("depth scale", Verdict.FAULT, value, _scale_advice(motion.scale))
    if math.isnan(middle):
        return Finding("depth scale", Verdict.UNKNOWN, "no depth")
    if m.depth_scale is not None:
        doubt = scale_doubt(middle, m.depth_scale)
        if doubt is None:
            return Finding("depth scale", Verdict.GOOD, value)
        return Finding("depth scale", Verdict.FAULT if doubt.wrong else Verdict.NOTE, value, doubt.advice)
    if USUAL_M[0] <= middle <= USUAL_M[1]:
        return Finding("depth scale", Verdict.GOOD, value)
    likely = [factor for factor in (5.0, 0.2, 1000.0, 0.001) if USUAL_M[0] <= middle / factor <= USUAL_M[1]]
    advice = _scale_advice(likely[0]) if likely else "no hand-held camera looks there: pass the right --depth-scale"
    return Finding("depth scale", Verdict.FAULT, value, advice)


def _scale_advice(factor: float) -> str:
    much = f"{factor:.3g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
    return f"depth seems {much}: multiply the depth scale by {factor:.3g} (--depth-scale; 1000: mm, 5000: TUM)"


def _registration(m: Measured) -> Finding:
    name, edges = "colour on depth", m.edges
    if m.camera.width < SMALL_WIDTH:
        return Finding(
            name, Verdict.UNKNOWN, f"edges of images {m.camera.width} px wide tell little", "record larger ones"
        )
    if edges.strength < STRONG and m.view is not None:
        return another_view(name, m.view, m.camera)
    if edges.strength < STRONG:
        return Finding(name, Verdict.UNKNOWN, "too few edges in depth to tell", "film objects in front of others")
    right, down = edges.shift
    verdict = _graded(math.hypot(right, down) / m.camera.width, SHIFT_NOTE, SHIFT_FAULT, below=False)
    value = f"depth edges lie {right:+.0f} px right, {down:+.0f} px below the colour's"
    advice = "depth is not registered to colour: register it with the camera's software, or repair the extrinsics"
    if verdict is Verdict.NOTE:
        advice = "a slight shift: registered with nominal extrinsics? calibrate the two cameras for the best accuracy"
    return Finding(name, verdict, value, _unless_good(verdict, advice))


def _offset(m: Measured) -> Finding:
    name, edges = "colour to depth time", m.edges
    if edges.strength < STRONG or edges.contrast < CONTRAST or m.timing is None:
        return Finding(name, Verdict.UNKNOWN, "too few edges in depth, or too little motion, to tell")
    late = edges.fine_lag * m.timing.period_s
    value = f"depth shows what colour showed {abs(late):.3f} s {'before' if late >= 0 else 'after'}"
    if abs(edges.fine_lag) < LATE_NOTE:
        return Finding(name, Verdict.GOOD, value)
    verdict = Verdict.FAULT if abs(late) >= LATE_FAULT_S else Verdict.NOTE
    sign = "subtract" if late > 0 else "add"
    return Finding(name, verdict, value, f"{sign} {abs(late):.3f} s {'from' if late > 0 else 'to'} the depth's stamps")


def _intrinsics(m: Measured) -> Finding:
    name, fit = "intrinsics", m.calibration
    if fit is None or fit.pairs < CALIBRATION_PAIRS:
        return Finding(name, Verdict.UNKNOWN, "too few corners followed over several frames to tell")
    sigma = fit.focal_sigma / fit.focal_factor
    center = max(map(abs, fit.center_px)) / m.camera.width
    center_sigma = fit.center_sigma_px / m.camera.width
    value = (
        f"motion fits {100 * (fit.focal_factor - 1):+.1f} +- {100 * fit.focal_sigma:.1f} % focal length, "
        f"{fit.center_px[0]:+.0f}, {fit.center_px[1]:+.0f} +- {fit.center_sigma_px:.0f} px centre"
    )
    if max(SIGMAS * sigma, SIGMAS * center_sigma) > 2.0 * FOCAL_LIMIT:
        return Finding(name, Verdict.UNKNOWN, value, "turn and approach more, so that the motion can tell")
    if abs(math.log(fit.focal_factor)) > max(FOCAL_LIMIT, SIGMAS * sigma):
        fx, fy = (fit.focal_factor * f for f in (m.camera.fx, m.camera.fy))
        advice = f"wrong focal length? the images move as with fx {fx:.0f}, fy {fy:.0f}; calibrate, check the size"
        return Finding(name, Verdict.FAULT, value, advice)
    if center > max(CENTER_LIMIT, SIGMAS * center_sigma):
        cx, cy = (c + d for c, d in zip((m.camera.cx, m.camera.cy), fit.center_px, strict=True))
        advice = f"wrong principal point? the images move as with cx {cx:.0f}, cy {cy:.0f}; calibrate, check the size"
        return Finding(name, Verdict.FAULT, value, advice)
    return Finding(name, Verdict.GOOD, value)


def _overlap(m: Measured) -> Finding:
    if not m.tracks.kept:
        return Finding("image motion", Verdict.UNKNOWN, "no corners to follow", "film something with texture")
    kept = float(np.median(m.tracks.kept))
    flow = np.percentile(m.tracks.flow, [50, 95]) if m.tracks.flow else [np.nan, np.nan]
    value = f"{flow[0]:.0f} px a frame, 5 % above {flow[1]:.0f} px; {100 * kept:.0f} % of corners found again"
    verdict = _graded(kept, KEPT_NOTE, KEPT_FAULT, below=True)
    advice = _unless_good(verdict, "neighbouring frames share too little: move slower, keep every frame")
    return Finding("image motion", verdict, value, advice)


def _blur(m: Measured) -> Finding:
    widths = [image.edge_px for image in m.images if not math.isnan(image.edge_px)]
    if not widths:
        return Finding("sharpness", Verdict.NOTE, "no strong edges", "dark, foggy or bare images: light and focus?")
    middle, high = np.percentile(widths, [50, 90])
    value = f"edges {middle:.1f} px wide, {high:.1f} px in the worst tenth"
    if middle > BLURRED_PX:
        return Finding("sharpness", Verdict.NOTE, value, "blurred: more light, shorter exposure, slower motion, focus")
    return Finding("sharpness", Verdict.GOOD, value)


def _brightness(m: Measured) -> Finding | None:
    mean = float(np.mean([image.brightness for image in m.images])) if m.images else 128.0
    if DARK <= mean <= BRIGHT:
        return None
    what = "dark: more light or a longer exposure" if mean < DARK else "overexposed: a shorter exposure"
    return Finding("brightness", Verdict.NOTE, f"mean gray level {mean:.0f} of 255", what)


def _reference(m: Measured) -> Finding | None:
    motion = m.motion
    if motion is None:
        return None
    if len(motion.step_m) == 0:
        advice = "its times do not overlap the frames': another clock or another recording?"
        return Finding("reference", Verdict.FAULT, f"{100 * motion.covered:.0f} % of frames have a pose", advice)
    metres, degrees = np.percentile(motion.step_m, 95), np.percentile(motion.step_deg, 95)
    value = (
        f"{100 * motion.covered:.0f} % of frames have a pose; {100 * np.median(motion.step_m):.1f} cm, "
        f"{np.median(motion.step_deg):.1f} degrees a frame, 5 % above {100 * metres:.1f} cm, {degrees:.1f} degrees"
    )
    return Finding("reference", Verdict.GOOD, value)


def _depth_range(m: Measured) -> tuple[float, float, float]:
    """5 %, median, 95 % of the depth, m: medians over the frames."""
    rows = np.array([image.depth_m for image in m.images if not math.isnan(image.depth_m[1])]).reshape(-1, 3)
    low, middle, high = np.median(rows, axis=0) if len(rows) else [math.nan] * 3
    return float(low), float(middle), float(high)


def _graded(value: float, note: float, fault: float, *, below: bool) -> Verdict:
    """GOOD up to `note`, FAULT beyond `fault`; below: where small values are the bad ones."""
    beyond = (value < fault, value < note) if below else (value > fault, value > note)
    return Verdict.FAULT if beyond[0] else Verdict.NOTE if beyond[1] else Verdict.GOOD


def _unless_good(verdict: Verdict, advice: str) -> str:
    return "" if verdict is Verdict.GOOD else advice
