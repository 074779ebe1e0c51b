"""Loss is an event: covered lenses, jumps and wide steps are survived, a place never seen is never found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from rendered import SMALL, Film, film

from idrgbdo_torch.config import Config, KeyframeConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import Frame, RgbdFrame, prepare
from idrgbdo_torch.kernels.se3 import retract
from idrgbdo_torch.odometry import Run, Status, TrackResult, run
from idrgbdo_torch.tracker import alignment, loss, recovery
from idrgbdo_torch.tracker.features import FULL, HALF, Features, features, pose_from_features, strangers
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.places import MOST, Places, without_images
from idrgbdo_torch.tracker.recovery import aligned
from idrgbdo_torch.tracker.tracking import Pair
from idrgbdo_torch.tracker.verification import LIMITS, verify


def black(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, gray=torch.zeros_like(frame.gray), depth=torch.zeros_like(frame.depth))


def at(frames: Sequence[RgbdFrame], order: Sequence[int]) -> list[RgbdFrame]:
    """These frames one after the other, 1/30 s apart."""
    return [replace(frames[k], timestamp=n / 30) for n, k in enumerate(order)]


def off_m(done: Run, desk: Film, order: Sequence[int]) -> np.ndarray:
    """Distance of every pose from the truth, world = first frame."""
    truth = [desk.T(0, k)[:3, 3] for k in order]
    return np.array([float((r.result.T_world_cam[:3, 3] - t).norm()) for r, t in zip(done.records, truth, strict=True)])


def test_black_frames_cost_themselves(desk: Film) -> None:
    """While the lens is covered the camera goes on for eight frames; the first that sees is found, not started anew."""
    order = [*range(20), *([19] * 6), *range(27, 40)]
    frames = [black(f) if 20 <= n < 26 else f for n, f in enumerate(at(desk.frames, order))]
    odometry = IdRgbdo()
    done = run(odometry, frames)
    assert done.statuses[20:26] == (Status.LOST,) * 6
    assert Status.LOST not in done.statuses[26:] and {r.result.segment for r in done.records[26:]} == {0}
    assert off_m(done, desk, order)[26:].max() < 0.02
    assert list(odometry.maps()) == [0]


def test_a_jump_back_is_found_again_and_said(desk: Film) -> None:
    odometry = IdRgbdo(replace(Config(), keyframe=KeyframeConfig(threshold_bits=0.2)))
    order = [*range(40), *range(3, 12)]
    done = run(odometry, at(desk.frames, order))
    back = done.records[40:]
    assert any("found again in the keyframe of" in r.result.reason for r in back[:2])
    assert Status.LOST not in [r.result.status for r in back[1:]]
    assert off_m(done, desk, order)[41:].max() < 0.02
    found = next(r.result for r in back if "found again" in r.result.reason)
    assert found.status is Status.WEAK and found.T_ref_cam is not None and found.information is not None
    assert found.reference_time is not None and found.reference_time < 40 / 30


def test_a_broken_track_joins_what_it_sees_again(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new segment starts while nothing is found; once it is, all of it lies where it belongs."""
    order = [*range(8), *([8] * 5), *range(20, 30), *range(29, 4, -1)]
    frames = [black(f) if 8 <= n < 13 else f for n, f in enumerate(at(desk.frames, order))]
    odometry = IdRgbdo(replace(Config(), keyframe=KeyframeConfig(threshold_bits=0.1)))
    with monkeypatch.context() as blind:
        blind.setattr(loss, "find_near", lambda *_: None)
        blind.setattr(loss, "find_in_window", lambda *_: None)
        blind.setattr(loss, "find_in_places", lambda *_: None)
        blind.setattr(loss, "find_in_newest", lambda *_: None)
        blind.setattr(alignment, "start_from_features", lambda *_: None)
        blind.setattr(odometry, "_start_segment", partial(start_elsewhere, odometry))
        before = [odometry.track(frame) for frame in frames[:23]]
    assert before[-1].segment == 1 and len(odometry.maps()) == 2
    wrong = before[-1].T_world_cam[:3, 3] - desk.T(0, order[22])[:3, 3]
    after = [odometry.track(frame) for frame in frames[23:]]
    joined = [k for k, result in enumerate(after) if "segment 1 joins 0" in result.reason]
    assert len(joined) == 1 and after[joined[0]].status is Status.WEAK and after[-1].segment == 0
    assert wrong.norm() > 0.5
    truth = torch.stack([desk.T(0, k)[:3, 3] for k in order])
    moved = odometry.trajectory().positions - truth
    assert moved[[*range(8), *range(14, len(order))]].norm(dim=1).max() < 0.02  # those before the joining included
    assert list(odometry.maps()) == [0]


def start_elsewhere(odometry: IdRgbdo, frame: Frame, reason: str) -> TrackResult:
    """A new segment, a metre away from where the track broke."""
    if odometry.reference is not None:
        odometry.motion.T_cam_world = retract(np.array([1.0, 0, 0, 0, 0.3, 0]), odometry.motion.T_cam_world)
        odometry.motion.said = None
    return IdRgbdo._start_segment(odometry, frame, reason)


def test_a_place_never_seen_is_never_found(desk: Film) -> None:
    for kind in ("nostructure_texture", "structure_texture"):
        elsewhere = film(replace(SMALL, kind=kind, frames=12, seed=11))
        frames = [replace(f, timestamp=n / 30) for n, f in enumerate([*desk.frames[:20], *elsewhere.frames])]
        odometry = IdRgbdo()
        done = run(odometry, frames)
        assert not any("found" in record.result.reason for record in done.records)
        assert done.records[-1].result.segment > 0 and len(odometry.maps()) == 2


@pytest.mark.parametrize("step", [9, 12])
def test_views_far_apart_start_from_their_features(desk: Film, step: int) -> None:
    """18 cm and 10 degrees between two frames, and more."""
    for first in (0, 10, 20):
        odometry = IdRgbdo()
        done = run(odometry, at(desk.frames, [first, first + step]))
        assert done.statuses[1] is not Status.LOST
        error = se3.inverse(desk.T(first, first + step)) @ done.records[1].result.T_world_cam
        assert error[:3, 3].norm() < 0.01
        assert desk.T(first, first + step)[:3, 3].norm() > 0.1


def test_wide_steps_are_measured_by_all_spread_out_points(desk: Film) -> None:
    """16 cm between two frames: 24 points alone are off by 1.4 mm (root mean square)."""
    errors = []
    for first in range(0, 31, 3):
        odometry = IdRgbdo()
        odometry.track(desk.frames[first])
        T = odometry.track(desk.frames[first + 8]).T_world_cam
        errors.append(float((T[:3, 3] - desk.T(first, first + 8)[:3, 3]).norm()))
    assert np.sqrt(np.mean(np.square(errors))) < 0.0008


def test_features_see_a_pose_through_perspective(desk: Film) -> None:
    host, target = (prepare(desk.frames[k]) for k in (0, 8))
    T = pose_from_features(features(host, FULL), features(target, FULL), target.intrinsics[FULL])
    assert T is not None
    assert T.supports(T.T_target_host) and not T.supports(np.diag([1.0, -1.0, -1.0, 1.0]))
    assert float((torch.from_numpy(T.T_target_host) @ se3.inverse(desk.T(8, 0)))[:3, 3].norm()) < 0.02
    blank = prepare(black(desk.frames[8]))
    assert pose_from_features(features(host, FULL), features(blank, FULL), target.intrinsics[FULL]) is None


def test_a_place_needs_no_images_to_be_aligned_to(desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, desk.frames[:2])
    assert odometry.reference is not None
    whole = odometry.reference.keyframe
    place = without_images(whole)
    assert len(place.points.uv) == len(np.union1d(whole.coarse, whole.witnesses))
    assert sum(image.nbytes for image in place.frame.images) < 100
    pair = Pair(prepare(desk.frames[3]), place, odometry.noise, odometry.backend)
    tracked, verdict = aligned(pair, np.eye(4), 3)
    assert verdict.bright > 0.95
    assert float((torch.from_numpy(tracked.T_frame_kf) @ se3.inverse(desk.T(3, 0)))[:3, 3].norm()) < 0.002


def test_what_was_lost_is_not_found_by_brightness_alone(desk: Film) -> None:
    """64 points of a real desk agreed in brightness 30 degrees from where the camera was; 11 of them had depth."""
    odometry = IdRgbdo(compile_ahead=False)
    for frame in desk.frames[:2]:
        odometry.track(frame)
    assert odometry.reference is not None and odometry.last is not None
    pair, tracked = (
        Pair(prepare(desk.frames[1]), odometry.reference.keyframe, odometry.noise, odometry.backend),
        odometry.last[1],
    )
    verdict = verify(pair, tracked)
    assert verdict.depths > 100 and recovery.sure(0, pair, tracked, verdict) is not None
    column, depth = np.arange(pair.frame.depth.shape[1]), pair.frame.depth
    narrow = [replace(pair, frame=replace(pair.frame, depth=np.where(column < w, depth, 0))) for w in range(4, 64, 4)]
    few = next(pair for pair in narrow if verify(pair, tracked).depths > 4)
    verdict = verify(few, tracked)
    assert verdict.depths < 12 and not verdict.doubt(LIMITS.sure)  # judged by brightness, and sure of it
    assert recovery.sure(0, few, tracked, verdict) is None


def test_a_place_keeps_what_belongs_to_its_points(desk: Film) -> None:
    odometry = IdRgbdo(compile_ahead=False)
    odometry.track(desk.frames[0])
    assert odometry.reference is not None
    whole = odometry.reference.keyframe
    place = without_images(whole)
    where = {tuple(uv): n for n, uv in enumerate(whole.points.uv.tolist())}
    numbers = [where[tuple(uv)] for uv in place.points.uv.tolist()]
    assert len(numbers) < len(whole.points.uv)
    for mine, all_of_them in (
        (place.points.slope, whole.points.slope),
        (place.points.inv_depth, whole.points.inv_depth),
        (place.points.patch[0], whole.points.patch[0]),
        (place.measured, whole.measured),
    ):
        assert np.array_equal(mine, all_of_them[numbers])


def test_places_are_bounded(desk: Film) -> None:
    odometry = IdRgbdo()
    run(odometry, desk.frames[:1])
    assert odometry.reference is not None
    places = Places()
    for number in range(MOST + 30):
        places.add(number, odometry.reference.keyframe)
    numbers = [place.number for place in places.kept]
    assert len(numbers) <= MOST and numbers == sorted(numbers) and numbers[0] == 0 and numbers[-1] == MOST + 29


def fail(*_: object) -> None:
    raise AssertionError("a search that can find nothing")


@pytest.mark.parametrize("black_too", [True, False])
def test_a_frame_without_depth_is_not_searched_for(
    desk: Film, monkeypatch: pytest.MonkeyPatch, black_too: bool
) -> None:
    """None of its poses could be verified; the frame after it is searched for."""
    hidden = [black(f) if black_too else replace(f, depth=torch.zeros_like(f.depth)) for f in desk.frames[6:9]]
    odometry = IdRgbdo()
    run(odometry, desk.frames[:6])
    with monkeypatch.context() as searching:
        searching.setattr(alignment, "recover", fail)
        searching.setattr(alignment, "start_from_features", fail)
        for name in ("find_near", "find_in_window", "find_in_places", "find_in_newest"):
            searching.setattr(loss, name, fail)
        assert [odometry.track(frame).status for frame in hidden] == [Status.LOST] * 3
    T = odometry.track(desk.frames[9]).T_world_cam
    assert float((T[:3, 3] - desk.T(0, 9)[:3, 3]).norm()) < 0.005


def clear(frame: Frame, monkeypatch: pytest.MonkeyPatch) -> Frame:
    """The frame, with its features said to be of a clear image: those of a small one are few."""
    found = replace(features(frame, HALF), clear=True)
    monkeypatch.setitem(vars(frame)["_features"], HALF, found)
    return frame


def test_clear_images_of_different_places_are_strangers(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = film(replace(SMALL, kind="structure_texture", frames=1, seed=11))
    here, near, other = (prepare(frame) for frame in (desk.frames[0], desk.frames[4], elsewhere.frames[0]))
    assert not strangers(other, here)  # small images are never clear
    here, near, other = (clear(frame, monkeypatch) for frame in (here, near, other))
    assert not strangers(near, here)
    assert strangers(other, here) and strangers(here, other)


def test_what_is_dear_comes_last(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    """Strangers are not searched for directly until nothing else finds them."""
    searches: list[str] = []

    def noted(name: str) -> None:
        monkeypatch.setattr(loss, name, lambda *_: searches.append(name))

    monkeypatch.setattr(alignment, "strangers", lambda *_: True)
    monkeypatch.setattr(alignment, "recover", fail)
    monkeypatch.setattr(recovery, "strangers", lambda *_: True)
    monkeypatch.setattr(recovery, "recover", lambda *_: searches.append("recover") or alignment.NOTHING)
    for name in ("find_in_window", "find_in_places", "find_near"):
        noted(name)
    elsewhere = film(replace(SMALL, kind="structure_texture", frames=1, seed=11)).frames[0]
    odometry = IdRgbdo()
    run(odometry, desk.frames[:4])
    assert odometry.track(replace(elsewhere, timestamp=4 / 30)).status is Status.LOST
    assert searches == ["find_in_window", "find_in_places", "find_near", "recover"]


def test_few_places_are_tried_the_most_alike_first(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    odometry = IdRgbdo()
    run(odometry, desk.frames[:1])
    assert odometry.reference is not None
    places = Places()
    for number in (0, 9, 39, 30, 20, 34):
        places.add(number, replace(odometry.reference.keyframe, frame=prepare(desk.frames[number])))
    tried: list[int] = []

    def give_up(host: Features, *_: object) -> None:
        tried.append(next(place.number for place in places.kept if place.features is host))

    monkeypatch.setattr(recovery, "pose_from_matches", give_up)
    pair = Pair(prepare(desk.frames[38]), odometry.reference.keyframe, odometry.noise, odometry.backend)
    assert recovery.find_in_places(pair, places.kept) is None
    assert len(tried) == recovery.TRIED and tried[:2] == [39, 34]


def test_nothing_is_looked_for_where_nothing_is_lost(desk: Film, monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in (
        (alignment, "start_from_features"),
        (loss, "find_near"),
        (loss, "find_in_window"),
        (loss, "find_in_places"),
    ):
        monkeypatch.setattr(module, name, fail)
    odometry = IdRgbdo()
    done = run(odometry, desk.frames)
    assert done.statuses == (Status.OK,) * 40
    assert evaluate(done.trajectory(), desk.groundtruth).ate.rmse_m < 0.003
