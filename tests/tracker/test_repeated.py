"""Images that a camera gave twice: what they show is of an earlier time, and they are taken for that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.odometry import Run, Status, run
from idrgbdo_torch.runs.checkpoint import CONSTANTS, TYPES
from idrgbdo_torch.runs.tree import Codec
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.repeated import LONGEST_S, Seen


def with_images_of(frame: RgbdFrame, other: RgbdFrame, *names: str) -> RgbdFrame:
    """The frame with some of another one's images."""
    return replace(frame, **{name: getattr(other, name) for name in names})


def repeating(frames: Sequence[RgbdFrame], at: Sequence[int], *names: str) -> list[RgbdFrame]:
    """The frames, where at some the driver passes on images of the frame before."""
    out = list(frames)
    for k in at:
        out[k] = with_images_of(out[k], out[k - 1], *names)
    return out


def ate_mm(done: Run, desk: Film) -> float:
    return 1e3 * evaluate(done.trajectory(), desk.groundtruth).ate.rmse_m


def test_a_repeated_colour_image_says_nothing_about_where_the_camera_is(desk: Film) -> None:
    """It is weak and lies where motion and depth put it; the frames around it do not notice."""
    at = [12, 19, 26, 33]
    clean, done = (run(IdRgbdo(), f) for f in (desk.frames, repeating(desk.frames, at, "gray", "color")))
    reasons = {n: r.result.reason for n, r in enumerate(done.records) if r.result.status is not Status.OK}
    assert reasons == {n: "the colour image is that of the frame before" for n in at}
    off = [float((r.result.T_world_cam[:3, 3] - desk.T(0, n)[:3, 3]).norm()) for n, r in enumerate(done.records)]
    moved = [float(desk.T(n - 1, n)[:3, 3].norm()) for n in at]
    assert min(moved) > 0.015 and max(off[n] for n in at) < 0.008, (off, moved)
    assert ate_mm(done, desk) < ate_mm(clean, desk) + 2.0


def test_such_a_frame_knows_how_little_it_knows(desk: Film) -> None:
    done = run(IdRgbdo(), repeating(desk.frames[:16], [12], "gray", "color"))
    spread = [r.result.covariance.diagonal().sqrt() for r in done.records]
    assert float(spread[12][:3].norm()) > 2.0 * float(spread[11][:3].norm())
    assert bool(spread[12].isfinite().all())


def test_a_camera_at_half_its_rate_is_tracked(desk: Film) -> None:
    """With colour images that are in time, and with such that are a frame late."""
    half = range(1, len(desk.frames), 2)
    late = [with_images_of(f, desk.frames[max(n - 1, 0)], "gray", "color") for n, f in enumerate(desk.frames)]
    for frames, most_mm in ((desk.frames, 6.0), (late, 14.0)):
        done = run(IdRgbdo(), repeating(frames, half, "gray", "color"))
        assert Status.LOST not in done.statuses
        assert all(r.result.status is Status.OK for r in done.records[2::2])
        assert ate_mm(done, desk) < most_mm


def test_late_colour_images_are_told_by_the_depth_that_fits_them(desk: Film) -> None:
    half = range(1, len(desk.frames), 2)
    late = [with_images_of(f, desk.frames[max(n - 1, 0)], "gray", "color") for n, f in enumerate(desk.frames)]
    for frames, is_late in ((desk.frames, False), (late, True)):
        odometry = IdRgbdo()
        run(odometry, repeating(frames, half, "gray", "color"))
        assert (odometry.motion.lateness > 0.0) is is_late


def test_repeated_depth_is_brought_to_its_frame(desk: Film) -> None:
    """It lies closer to the depth that was not given than it did."""
    odometry = IdRgbdo()
    run(odometry, desk.frames[:12])
    moved = odometry.motion.look(with_images_of(desk.frames[12], desk.frames[11], "depth")).depth
    true, old = desk.frames[12].depth, desk.frames[11].depth
    there = (moved > 0) & (true > 0) & (old > 0)
    off, before = ((z - true).abs()[there].median() for z in (moved, old))
    assert there.float().mean() > 0.6 and float(off) < 0.6 * float(before)


def test_repeated_depth_costs_nothing(desk: Film) -> None:
    done = run(IdRgbdo(), repeating(desk.frames, [12, 19, 26, 33], "depth"))
    assert set(done.statuses) == {Status.OK} and ate_mm(done, desk) < 1.2


def test_a_repeated_frame_does_not_stop_the_camera(desk: Film) -> None:
    """Its velocity stays what it was, so that the next frame is expected two steps on."""
    odometry = IdRgbdo()
    run(odometry, desk.frames[:15])
    before = odometry.motion.velocity()
    assert np.linalg.norm(before[:3]) > 0.1
    result = odometry.track(replace(desk.frames[14], timestamp=desk.frames[15].timestamp))
    assert result.status is Status.OK
    np.testing.assert_allclose(odometry.motion.velocity(), before, rtol=0.02, atol=0.01)
    assert odometry.motion.gap(desk.frames[16].timestamp) == pytest.approx(2 / 30, abs=1e-5)


def test_a_camera_that_rests_without_noise_is_seen_to_rest(desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, [*desk.frames[:10], *(replace(desk.frames[9], timestamp=(9 + n) / 30) for n in range(1, 8))])
    assert np.linalg.norm(odometry.motion.velocity()) < 0.01


def test_a_colour_image_that_stands_still_for_long_is_not_bridged(desk: Film) -> None:
    frames = [*desk.frames[:12], *(with_images_of(f, desk.frames[11], "gray", "color") for f in desk.frames[12:20])]
    done = run(IdRgbdo(), frames)
    bridged = [n for n, r in enumerate(done.records) if "colour image" in r.result.reason]
    assert bridged and max(bridged) - 11 <= LONGEST_S * 30


def test_black_images_are_no_repetition(desk: Film) -> None:
    dark = [replace(f, gray=torch.zeros_like(f.gray), depth=torch.zeros_like(f.depth)) for f in desk.frames[:2]]
    seen = Seen.after(Seen.after(None, dark[0]), dark[1])
    assert seen.gray_since == seen.depth_since == dark[1].timestamp


def test_what_was_seen_is_part_of_a_checkpoint(desk: Film) -> None:
    """So that a run which stops within a repetition goes on to the same bits."""
    frames = repeating(desk.frames[:24], range(11, 24, 2), "gray", "color")
    whole, begun = IdRgbdo(), IdRgbdo()
    for frame in frames[:14]:
        whole.track(frame)
        begun.track(frame)
    codec = Codec(TYPES, CONSTANTS)
    text, numbers = codec.write(begun)
    resumed = codec.read(text, memoryview(b"".join(bytes(part) for part in numbers)))
    for frame in frames[14:]:
        assert torch.equal(resumed.track(frame).T_world_cam, whole.track(frame).T_world_cam)
