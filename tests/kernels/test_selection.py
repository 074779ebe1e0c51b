"""The fused choice against its definition: whitened rows, Algorithm 1 done lazily, verification."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from plane_scene import P, Scene, both, close, intrinsics, plane_scene
from plane_world import AFFINE, CAMERA, SLANTED, T_TARGET_HOST, render
from torch import Tensor

from idrgbdo_torch.config import NoiseConfig, SelectionConfig
from idrgbdo_torch.definitions.image import sample_surface, sample_with_gradient
from idrgbdo_torch.definitions.photometric import (
    distortion_weight,
    gradient_information,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from idrgbdo_torch.definitions.selection import gain_bits, select_informative
from idrgbdo_torch.kernels import selection as choice
from idrgbdo_torch.kernels.verification import verify
from idrgbdo_torch.measurement import GRADIENT_NOISE, Agreement, Points, Rows, State, View, kernel_noise


@pytest.fixture(scope="module")
def scene() -> Scene:
    return plane_scene()


def test_whitened_rows_carry_the_point_s_information(scene: Scene) -> None:
    noise = kernel_noise(NoiseConfig(sigma_intensity=4.0, sigma_pixel=0.3))
    index = np.arange(200)
    A, seen, where = choice.whitened_rows(
        intrinsics(0), CAMERA.width, CAMERA.height, 20.0, scene.points, index, T_TARGET_HOST.numpy(), noise
    )
    uv, d, var_d = (scene.tensor(name, index) for name in ("uv", "inv_depth", "var_inv_depth"))
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    u, v = warped.centre.unbind(-1)
    inside = (u >= 20) & (u <= CAMERA.width - 21) & (v >= 20) & (v <= CAMERA.height - 21)
    assert seen.tolist() == inside.tolist() and 50 < seen.sum() < 200
    close(where[seen], warped.centre[inside])
    g = torch.from_numpy(scene.points.gradient[0]).double()
    h, _ = distortion_weight(projective_distortion(d, warped.P, T_TARGET_HOST), noise.c_h)
    phi = photometric_variance(g, warped.duv_dd, var_d.sqrt(), shared=P, sigma_intensity=4.0, sigma_pixel=0.3)
    signal = 1 - GRADIENT_NOISE * noise.var_intensity / (g.square().sum(-1) + 1e-9)  # share that is not noise
    assert 0.02 < (signal < 0).double().mean() < 0.9
    G = gradient_information(g, signal.clamp(min=0) / residual_variance(h, phi))
    expected = warped.duv_dxi.mT @ G @ warped.duv_dxi
    z = warped.P[:, 2]
    row = warped.dP_dxi[:, 2] / z[:, None] ** 2 / (noise.var_depth + var_d / (z * d) ** 4).sqrt()[:, None]
    expected = expected + row[..., None] * row[:, None]
    close(A[seen].transpose(0, 2, 1) @ A[seen], expected[inside])
    assert (A[~seen] == 0).all()
    blind = choice.whitened_rows(
        intrinsics(0), CAMERA.width, CAMERA.height, 20.0, scene.points, index, T_TARGET_HOST.numpy(),
        noise._replace(use_depth=False),
    )  # fmt: skip
    assert (blind.A[:, 2] == 0).all() and (A[seen, 2, 2] > 0).all()


def test_gains_and_the_covariance_after_a_choice() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((40, 3, 6)) * [1e3, 1e3, 1e3, 300, 300, 300] * rng.uniform(1e-3, 1, (40, 1, 1))
    C = np.diag(1 / np.array([1e4, 1e4, 1e4, 1e3, 1e3, 1e3]))
    information = torch.linalg.inv(torch.from_numpy(C))
    for n in range(40):
        gains = [choice.gain_bits(A, i, C, np.empty((3, 6))) for i in range(40)]
        close(np.array(gains), gain_bits(torch.from_numpy(A), information))
        for row in A[n]:
            choice.shrink(C, row)
        information = information + torch.from_numpy(A[n].T @ A[n])
        unit = information.diagonal().sqrt()
        close(unit[:, None] * torch.from_numpy(C) * unit, unit[:, None] * torch.linalg.inv(information) * unit)


@pytest.mark.parametrize("distance", [0.0, 25.0])
@pytest.mark.parametrize("seed", range(6))
def test_the_lazy_choice_is_algorithm_1(seed: int, distance: float) -> None:
    rng = np.random.default_rng(seed)
    n = 400
    A = rng.standard_normal((n, 3, 6)) * [1, 1, 1, 3, 3, 3] * rng.uniform(0.1, 2.0, (n, 1, 1))
    where, radius = rng.uniform(0, [320, 240], (n, 2)), rng.uniform(0, 1, n)
    seen = rng.uniform(size=n) < 0.8
    information = np.diag(rng.uniform(0.1, 1, 6))
    visible = np.flatnonzero(seen)
    for m in (1, 4, 6, 24, 60):
        mine = choice.select(Rows(A, seen, where), radius, m, m, information, 0.0, 0.5, 25.0, distance)
        expected = select_informative(
            torch.from_numpy(A[visible]), torch.from_numpy(radius[visible]), m, torch.from_numpy(information),
            SelectionConfig(spread=0.5, distance=distance), torch.from_numpy(where[visible]),
        )  # fmt: skip
        assert mine.tolist() == visible[expected.numpy()].tolist()
        assert len(mine) == m
        gaps = np.linalg.norm(where[mine, None] - where[mine], axis=-1) + 1e9 * np.eye(m)
        assert gaps.min() >= distance


@pytest.mark.parametrize("bits", [-1.0, -3.4, -3.6, -9.0])
def test_an_uncertain_pose_gets_more_points(bits: float) -> None:
    """As many as it takes to know the worst freedom to so many bits, at least m, at most `most`."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((300, 3, 6)) * [1, 1, 1, 3, 3, 3] * rng.uniform(0.1, 2.0, (300, 1, 1))
    where, radius = rng.uniform(0, [320, 240], (300, 2)), rng.uniform(0, 1, 300)
    rows, information = Rows(A, np.ones(300, np.bool_), where), np.diag(rng.uniform(0.1, 1, 6))
    chosen = choice.select(rows, radius, 8, 40, information, bits, 0.5, 25.0, 0.0)
    config = SelectionConfig(bits=bits, spread=0.5, distance=0.0)
    start = torch.from_numpy(information)
    expected = select_informative(torch.from_numpy(A), torch.from_numpy(radius), 8, start, config, most=40)
    assert chosen.tolist() == expected.tolist()

    def worst(count: int) -> float:
        known = information + np.einsum("nri,nrj->ij", A[chosen[:count]], A[chosen[:count]])
        return float(np.log2(np.linalg.inv(known).diagonal().max()) / 2)

    assert choice.worst_entropy(np.linalg.inv(information)) == pytest.approx(worst(0))
    assert len(chosen) == next((n for n in range(8, 40) if worst(n) <= bits), 40)
    assert {-1.0: len(chosen) == 8, -9.0: len(chosen) == 40}.get(bits, 8 < len(chosen) < 40)


def test_a_freedom_that_no_point_sees_does_not_stop_the_choice() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((50, 3, 6))
    A[:, :, 1] = 0.0
    where, radius, information = rng.uniform(0, 300, (50, 2)), rng.uniform(0, 1, 50), 1e-3 * np.eye(6)
    rows = Rows(A, np.ones(50, dtype=np.bool_), where)
    mine = choice.select(rows, radius, 12, 12, information, 0.0, 0.5, 25.0, 0.0)
    expected = select_informative(
        torch.from_numpy(A), torch.from_numpy(radius), 12, torch.from_numpy(information), SelectionConfig(spread=0.5)
    )
    assert mine.tolist() == expected.tolist()


def test_running_out_of_points_ends_the_choice() -> None:
    A = np.random.default_rng(0).standard_normal((9, 3, 6))
    where = np.zeros((9, 2))
    where[:, 0] = [0, 1, 2, 3, 100, 101, 102, 200, 300]
    rows = Rows(A, np.ones(9, dtype=np.bool_), where)
    chosen = choice.select(rows, np.zeros(9), 24, 24, np.eye(6), 0.0, 0.5, 25.0, 6.0)
    assert sorted(where[chosen, 0] // 100) == [0, 1, 2, 3]


def test_verify_counts_what_agrees(scene: Scene) -> None:
    """Exact points all agree; an offset spoils brightness, a wrong depth spoils depth, out of view does not count."""
    noise = kernel_noise(NoiseConfig())
    (_, d_host), _ = both()
    uv = torch.from_numpy(scene.points.uv)
    d = sample_surface(d_host, uv)[0]
    target = render(T_TARGET_HOST, SLANTED)
    image, depth = target[0].float().numpy(), (1 / target[1]).float().numpy()
    warped = warp(CAMERA, uv, d, T_TARGET_HOST)
    value, _, valid = sample_with_gradient(torch.from_numpy(image), warped.centre)
    patch = ((value - AFFINE[1]) / AFFINE[0].exp())[:, None].float().numpy()
    points = scene.points._replace(inv_depth=d.numpy(), patch=patch[None])
    view = View((image,), depth, intrinsics(0)[None])

    def counts(points: Points, affine: Tensor) -> Agreement:
        state = State(T_TARGET_HOST.numpy(), affine.numpy())
        return verify(view, 0, points, np.arange(200), state, noise, 12.0)

    seen, bright, with_depth, near, hidden, _ = counts(points, AFFINE)
    assert hidden == 0
    assert seen == int(valid.sum()) < 200 and bright == seen
    assert with_depth == int(sample_surface(target[1], warped.centre, 0.1)[2][valid].sum()) and near == with_depth
    assert counts(points, AFFINE + torch.tensor([0.0, 13.0]))[1] == 0
    assert counts(points, AFFINE + torch.tensor([0.0, 11.0]))[1] == seen
    wrong = d.numpy().copy()
    wrong[::2] *= 1.15
    _, _, with_depth, near, hidden, _ = counts(points._replace(inv_depth=wrong), AFFINE)
    assert 0.35 * with_depth < near < 0.65 * with_depth and hidden == 0
    wrong[::2] *= 0.7  # now behind what the view sees there
    _, _, with_depth, near, hidden, bright = counts(points._replace(inv_depth=wrong), AFFINE)
    assert near + hidden == with_depth and hidden > 0.35 * with_depth and bright <= hidden
