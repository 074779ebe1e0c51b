"""Depth alone puts a frame on the surface that a keyframe saw, from far, and is sure of it only where it can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from rendered import SMALL, Film, film, rotation_deg

from idrgbdo_torch.config import Config
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import Frame, Keyframe, RgbdFrame, prepare
from idrgbdo_torch.kernels.se3 import retract
from idrgbdo_torch.kernels.surface import LAST, ROUGH, align_surface, surface_equations, surface_planes
from idrgbdo_torch.measurement import tracked_noise
from idrgbdo_torch.odometry import Status, run
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.members import Members
from idrgbdo_torch.tracker.surface import GATES, HELD, RADIUS, lay, least_facing, lies_on_all, lies_on_surface, surface
from idrgbdo_torch.tracker.tracking import Pair

CAMERA = np.array([200.0, 210.0, 79.5, 59.5])
SIGMA = 0.0025  # 1/m


def plane(normal: np.ndarray) -> np.ndarray:
    """(120, 160) float32 depth in m of the plane normal^T P = 1."""
    v, u = np.mgrid[:120, :160]
    x, y = (u - CAMERA[2]) / CAMERA[0], (v - CAMERA[3]) / CAMERA[1]
    return np.asarray(1.0 / (normal[0] * x + normal[1] * y + normal[2]), np.float32)


def box() -> np.ndarray:
    """(120, 160) float32 depth of a room's corner: three planes that meet in the view."""
    return np.minimum.reduce([plane(np.array(n)) for n in ((0.4, 0.1, 0.5), (-0.4, 0.1, 0.5), (0.0, -0.5, 0.45))])


def of(rgbd: RgbdFrame) -> Keyframe:
    config = Config()
    backend = backend_named(config.backend)
    return make_keyframe(prepare(rgbd), config, np.random.default_rng(0), backend)


def paired(frame: Frame, keyframe: Keyframe) -> Pair:
    config = Config()
    return Pair(frame, keyframe, tracked_noise(config), backend_named(config.backend))


def away(T: np.ndarray, metres: float, degrees: float, seed: int = 0) -> np.ndarray:
    """T after a motion by so much in a random direction."""
    rng = np.random.default_rng(seed)
    v, w = rng.normal(size=3), rng.normal(size=3)
    xi = np.concatenate([metres * v / np.linalg.norm(v), np.radians(degrees) * w / np.linalg.norm(w)])
    return np.asarray(retract(xi, T))


def test_planes_are_those_of_the_image() -> None:
    normal = np.array([0.2, -0.3, 0.7])
    found = surface_planes(plane(normal), CAMERA, 8, RADIUS, SIGMA)
    assert len(found) > 200
    assert found[:, :3] @ normal == pytest.approx(np.ones(len(found)), abs=1e-5)
    unit = np.tile(normal / np.linalg.norm(normal), (len(found), 1))
    assert found[:, 3:] == pytest.approx(unit, abs=1e-3)


def test_no_planes_where_there_is_no_depth() -> None:
    depth = plane(np.array([0.0, 0.0, 0.5]))
    depth[:, :80] = 0.0
    depth[:60] *= -1.0  # left out, as something in front
    found = surface_planes(depth, CAMERA, 8, RADIUS, SIGMA)
    assert len(found) and found[:, 0].min() > 0.0 and found[:, 1].min() > 0.0


def test_the_equations_are_the_derivative_of_the_distances() -> None:
    """b is minus half of the cost's gradient, H its Gauss-Newton matrix, by the same pixels at all steps."""
    depth, planes, T = box(), surface_planes(box(), CAMERA, 8, RADIUS, SIGMA), away(np.eye(4), 2e-4, 0.01)
    x = planes[:, :3] @ T[:3, :3].T + T[:3, 3]
    at = np.rint(CAMERA[:2] * x[:, :2] / x[:, 2:] + CAMERA[2:]).astype(int)
    z = depth[at[:, 1], at[:, 0]].astype(np.float64)
    P = np.column_stack([(at - CAMERA[2:]) / CAMERA[:2], np.ones(len(at))]) * z[:, None]

    def distances(xi: np.ndarray) -> np.ndarray:
        R, t = retract(xi, T)[:3, :3], retract(xi, T)[:3, 3]
        return np.asarray(((planes[:, 3:] @ R.T) * (P - planes[:, :3] @ R.T - t)).sum(axis=1))

    flat = np.abs(distances(np.zeros(6))) < 0.002  # at creases Huber has a say
    planes, P, z = planes[flat], P[flat], z[flat]
    H, b = np.zeros((6, 6)), np.zeros(6)
    surface_equations(depth, CAMERA, planes, T, SIGMA, LAST, H, b)
    J = np.column_stack([(distances(s) - distances(-s)) / 2e-6 for s in 1e-6 * np.eye(6)])
    weighted = J / ((SIGMA * z**2 * (planes[:, 3:] @ T[2, :3])) ** 2 + (ROUGH * z) ** 2)[:, None]
    np.testing.assert_allclose(H, weighted.T @ J, rtol=1e-5, atol=1e-5 * np.abs(H).max())
    np.testing.assert_allclose(b, -weighted.T @ distances(np.zeros(6)), rtol=1e-4, atol=1e-5 * np.abs(b).max())


@pytest.mark.parametrize("seed", range(6))
def test_a_corner_is_found_from_far(seed: int) -> None:
    """Two views of the same surface from one place: the truth is the identity."""
    planes, guess = surface_planes(box(), CAMERA, 4, RADIUS, SIGMA), away(np.eye(4), 0.2, 8.0, seed)
    T, _, seen, agree = align_surface(box(), CAMERA, planes, guess, HELD, SIGMA, GATES)
    assert np.linalg.norm(T[:3, 3]) < 0.003 and rotation_deg(torch.from_numpy(T)) < 0.15
    assert seen > 0.98 and agree > 0.98


def test_what_a_wall_leaves_open_stays_as_guessed() -> None:
    wall = plane(np.array([0.0, 0.0, 0.5]))
    planes, guess = surface_planes(wall, CAMERA, 4, RADIUS, SIGMA), away(np.eye(4), 0.0, 0.0)
    guess[:3, 3] = 0.1, -0.05, 0.2
    T, *_ = align_surface(wall, CAMERA, planes, guess, HELD, SIGMA, GATES)
    assert T[:3, 3] == pytest.approx([0.1, -0.05, 0.0], abs=1e-3)


def test_no_number_is_no_surface() -> None:
    depth = box()
    depth[::3] = np.nan
    planes = surface_planes(depth, CAMERA, 4, RADIUS, SIGMA)
    assert np.isfinite(planes).all()
    T, H, *_ = align_surface(
        depth, CAMERA, surface_planes(box(), CAMERA, 4, RADIUS, SIGMA), np.eye(4), HELD, SIGMA, GATES
    )
    assert np.isfinite(T).all() and np.isfinite(H).all()


def test_walls_face_one_way_and_rooms_all() -> None:
    """With a sensor's noise, under which a wall's normals seem to face everywhere."""
    rng = np.random.default_rng(0)
    for depth, shaped in ((plane(np.array([0.1, 0.0, 0.5])), False), (box(), True)):
        noisy = np.asarray(1.0 / (1.0 / depth + rng.normal(0.0, 2.0 * SIGMA, depth.shape)), np.float32)
        normals = surface_planes(noisy, CAMERA, 4, RADIUS, SIGMA)[:, 3:]
        assert np.linalg.eigvalsh(normals.T @ normals / len(normals))[0] > 0.005
        assert (least_facing(normals) > 0.005) == shaped


def test_a_rendered_frame_is_laid_where_it_was(desk: Film) -> None:
    pair, truth = paired(prepare(desk.frames[6]), of(desk.frames[0])), desk.T(6, 0).numpy()
    for seed in range(4):
        laid = lay(pair, [away(truth, 0.8, 40.0, seed), away(truth, 0.05, 4.0, seed)])  # the better guess
        assert laid is not None and laid.agree > 0.9
        error = np.linalg.inv(truth) @ laid.T_frame_kf
        assert np.linalg.norm(error[:3, 3]) < 0.01 and rotation_deg(torch.from_numpy(error)) < 0.4


def test_depth_is_sure_of_the_truth_alone(desk: Film) -> None:
    pair, truth = paired(prepare(desk.frames[6]), of(desk.frames[0])), desk.T(6, 0).numpy()
    assert lies_on_surface(pair, truth)
    assert not any(lies_on_surface(pair, away(truth, 0.3, 10.0, seed)) for seed in range(8))


def test_depth_is_sure_of_nothing_before_a_wall() -> None:
    wall = film(replace(SMALL, kind="nostructure_texture", frames=2))
    pair, truth = paired(prepare(wall.frames[1]), of(wall.frames[0])), wall.T(1, 0).numpy()
    assert len(surface(pair.keyframe.frame, SIGMA).planes) > 1000
    assert not lies_on_surface(pair, truth)


def test_depth_is_sure_of_nothing_where_the_views_share_one_wall() -> None:
    """A keyframe sees a corner, a frame one of its walls: along that it may lie anywhere."""
    camera = Pinhole(width=160, height=120, fx=CAMERA[0], fy=CAMERA[1], cx=CAMERA[2], cy=CAMERA[3])
    left, right = plane(np.array([-0.4, 0.05, 0.5])), plane(np.array([0.4, 0.05, 0.5]))
    corner = np.minimum.reduce([left, right, plane(np.array([0.0, -0.5, 0.45]))])
    gray = np.random.default_rng(0).uniform(0, 255, corner.shape)
    frames = [
        RgbdFrame(float(n), torch.from_numpy(gray).float(), torch.from_numpy(np.ascontiguousarray(z)), camera)
        for n, z in enumerate((corner, corner, np.where(corner == right, right, 0.0).astype(np.float32)))
    ]
    keyframe = of(frames[0])
    assert surface(keyframe.frame, SIGMA).shaped
    assert lies_on_surface(paired(prepare(frames[1]), keyframe), np.eye(4))
    assert not lies_on_surface(paired(prepare(frames[2]), keyframe), np.eye(4))


def test_of_two_guesses_the_one_that_more_planes_agree_with_is_taken() -> None:
    """Aside along a wall few planes are in view, and all of them agree; at the truth some are hidden."""
    camera = Pinhole(width=160, height=120, fx=CAMERA[0], fy=CAMERA[1], cx=CAMERA[2], cy=CAMERA[3])
    wall = plane(np.array([0.0, 0.0, 0.5]))
    seen = wall.copy()
    seen[40:70, 40:70] = 1.0  # something in front
    gray = torch.from_numpy(np.random.default_rng(0).uniform(0, 255, wall.shape)).float()
    keyframe = of(RgbdFrame(0.0, gray, torch.from_numpy(wall), camera))
    aside = np.eye(4)
    aside[0, 3] = 1.2
    laid = lay(paired(prepare(RgbdFrame(1.0, gray, torch.from_numpy(seen), camera)), keyframe), [aside, np.eye(4)])
    assert laid is not None and np.linalg.norm(laid.T_frame_kf[:3, 3]) < 0.1


def test_something_in_front_lies_on_no_surface_of_the_window(desk: Film) -> None:
    keyframes = [of(desk.frames[k]) for k in (0, 4)]
    members = Members.none(1, 8)
    for k, keyframe in zip((0, 4), keyframes, strict=True):
        members = members.append(keyframe, np.arange(1), desk.T(k, 0).numpy(), np.zeros(2))
    frame, truth = prepare(desk.frames[6]), desk.T(6, 0).numpy()
    noise, backend = tracked_noise(Config()), backend_named(Config().backend)
    assert lies_on_all(frame, truth, members, noise, backend)
    shown = desk.frames[6]
    near = shown.depth.clone()
    near[60:180, 40:200] = 0.4
    assert not lies_on_all(prepare(replace(shown, depth=near)), truth, members, noise, backend)
    assert not lies_on_all(frame, truth, members.keep(np.array([True, False])), noise, backend)  # one alone says little


def lit_otherwise(frame: RgbdFrame, number: int) -> RgbdFrame:
    """The frame under a light that wanders: part of the image brighter by 15 gray levels, part of it darker."""
    assert frame.gray is not None
    across = torch.arange(frame.gray.shape[1]) / frame.gray.shape[1]
    light = 15.0 * torch.sin(2.0 * torch.pi * (across + 0.31 * number))
    return replace(frame, gray=(frame.gray + light).clamp(0.0, 255.0), timestamp=number / 3.0)


def test_light_that_changes_between_wide_steps_is_no_loss(desk: Film) -> None:
    """A third of a second apart brightness agrees in half of the points, and depth is sure."""
    order = range(0, 40, 5)
    done = run(IdRgbdo(), [lit_otherwise(desk.frames[k], n) for n, k in enumerate(order)])
    assert Status.LOST not in done.statuses
    for record, k in zip(done.records, order, strict=True):
        assert float((se3.inverse(desk.T(0, k)) @ record.result.T_world_cam)[:3, 3].norm()) < 0.02
