"""The fused linearisation of the window against the chain rule by autograd; its Schur complement against dense."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from plane_world import CAMERA, SLANTED, render
from torch import Tensor
from torch.func import jacfwd

from idrgbdo_torch.config import NoiseConfig
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.image import sample_surface, sample_with_gradient
from idrgbdo_torch.definitions.photometric import (
    PATTERN,
    WIDE_PATTERN,
    distortion_weight,
    photometric_variance,
    projective_distortion,
    residual_variance,
    warp,
)
from idrgbdo_torch.definitions.solver import huber_weight, normal_equations, robust_cost
from idrgbdo_torch.kernels.assembly import assemble, distances, eliminate_depths
from idrgbdo_torch.kernels.window import linearise_window
from idrgbdo_torch.measurement import (
    COMPACT,
    STEP,
    WIDE,
    Noise,
    Views,
    WindowPairs,
    WindowPoints,
    WindowState,
    WindowSystem,
    kernel_noise,
)

P = len(PATTERN)
K, N = 3, 6  # keyframes, points of each
CAM = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])


@dataclass(frozen=True)
class State:
    """Poses, brightness and inverse depths of a window."""

    T: Tensor  # (K, 4, 4) T_cam_world
    affine: Tensor  # (K, 2)
    inv_depth: Tensor  # (K, N)

    def moved(self, step: Tensor) -> State:
        """The state after increments (8 K + K N,): [v, w, a, b] of each keyframe, then the inverse depths."""
        frames, depths = step[: STEP * K].reshape(K, STEP), step[STEP * K :].reshape(K, N)
        return State(se3.retract(frames[:, :6], self.T), self.affine + frames[:, 6:], self.inv_depth + depths)

    def relative(self, target: int, host: int) -> Tensor:
        return self.T[target] @ se3.inverse(self.T[host])


@dataclass(frozen=True)
class Scene:
    """A slanted plane seen by three keyframes, nothing exact: what the kernel reads."""

    images: np.ndarray
    depths: np.ndarray
    points: WindowPoints
    state: State
    linear: State  # where the geometry is linearised: poses of another state


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(3)
    generator = torch.Generator().manual_seed(3)
    scale = torch.tensor([0.05, 0.05, 0.05, 0.02, 0.02, 0.02], dtype=torch.float64)
    truth = se3.exp(scale * torch.randn(K, 6, generator=generator, dtype=torch.float64))
    gray, inverse_depth = zip(*(render(T, SLANTED) for T in truth), strict=True)
    images = np.zeros((K, CAMERA.height, CAMERA.width), dtype=np.float32)
    depths = np.zeros_like(images)
    for k in range(K):
        images[k] = gray[k].numpy() + 5 * rng.standard_normal(images[k].shape)
        depths[k] = 1 / inverse_depth[k].numpy()
        depths[k, 40:80] *= 1.2  # another surface
        depths[k, :, 250:] = 0.0
    uv = torch.from_numpy(rng.uniform([4, 4], [CAMERA.width - 5, CAMERA.height - 5], (K, N, 2)))
    patch, gradient, _ = sample_with_gradient(torch.from_numpy(images), uv[:, :, None] + PATTERN)
    measured = torch.stack([sample_surface(d, x)[0] for d, x in zip(inverse_depth, uv, strict=True)])
    valid = np.ones((K, N), dtype=np.bool_)
    valid[1, 5:] = False
    points = WindowPoints(
        uv.numpy(), patch.float().numpy(), gradient.float().numpy(), measured.numpy(),
        rng.uniform(0.5, 2.0, (K, N)) * 0.004**2, valid, 0.001 * rng.standard_normal((K, N, 2)),
    )  # fmt: skip

    def near(size: float) -> State:
        step = size * torch.randn(STEP * K, generator=generator, dtype=torch.float64)
        depths = 0.02 * torch.randn(K * N, generator=generator, dtype=torch.float64)
        affine = torch.tensor([[0.01, 1.0], [-0.02, -2.0], [0.03, 1.0]], dtype=torch.float64)
        return State(truth, affine, measured).moved(torch.cat([step, depths]))

    return Scene(images, depths, points, near(0.003), near(0.005))


def views(scene: Scene) -> Views:
    return Views(tuple(scene.images), tuple(scene.depths), CAM)


def as_arrays(state: State, linear: State) -> WindowState:
    return WindowState(state.T.numpy(), linear.T.numpy(), state.affine.numpy(), state.inv_depth.numpy())


def fused(
    scene: Scene, linear: State, pairs: np.ndarray, limit: float, noise: Noise
) -> tuple[Tensor, Tensor, float, np.ndarray]:
    """The kernels' normal equations as one dense system, their energy and the points' rms (host, point, target)."""
    system, taken = WindowSystem.empty(K, N), WindowPairs.empty(K, N)
    for part in (*system, *(part for part in taken if part.dtype != np.bool_)):
        part[...] = np.nan  # whatever was there before must not matter
    taken.rms[:] = -1.0
    state = as_arrays(scene.state, linear)
    linearise_window(views(scene), state, scene.points, pairs, limit, noise, taken)
    energy = assemble(taken, state, scene.points, pairs, system)
    cross = system.cross.transpose(0, 2, 1).reshape(K * N, STEP * K)
    whole = np.block([[system.H, cross.T], [cross, np.diag(system.Hd.ravel())]])
    rhs = np.concatenate([system.b, system.bd.ravel()])
    return torch.from_numpy(whole), torch.from_numpy(rhs), energy, taken.rms.transpose(0, 2, 1)


def by_definition(
    scene: Scene, linear: State, pairs: np.ndarray, limit: float, noise: Noise
) -> tuple[Tensor, Tensor, float, np.ndarray]:
    """The same from photometric's functions, with derivatives by forward-mode autograd over every state variable."""
    n = STEP * K + K * N
    zero = torch.zeros(n, dtype=torch.float64)
    system = torch.zeros(n, n, dtype=torch.float64), zero
    energy, rms = 0.0, np.full((K, N, K), -1.0)
    state, points = scene.state, scene.points
    at_linear = State(linear.T, state.affine, state.inv_depth)  # brightness and depth are always taken at the state

    def add(residual: Callable[[Tensor], Tensor], r: Tensor, variance: Tensor, limit: float) -> float:
        nonlocal system
        s = r / variance.sqrt()
        system = normal_equations(jacfwd(residual)(zero), r, huber_weight(s, noise.huber, limit) / variance, system)
        return float(2 * robust_cost(s, noise.huber, limit).sum())

    for host, p, target in np.ndindex(K, N, K):
        if not (pairs[host, target] and points.valid[host, p]):
            continue
        if target == host:  # the sensor's own measurement of the point, not robust
            r = state.inv_depth[host, p] - points.measured[host, p]
            weight = torch.tensor([1 / points.variance[host, p]])
            J = jacfwd(lambda x, i=host, p=p: state.moved(x).inv_depth[i, p])(zero)
            system = normal_equations(J[None], r[None], weight, system)
            energy += float(weight * r**2)
            continue
        uv = torch.from_numpy(points.uv[host, p])
        patch, g_host = (torch.from_numpy(x[host, p]).double() for x in (points.patch, points.gradient))
        image = torch.from_numpy(scene.images[target]).double()
        depth = torch.from_numpy(scene.depths[target]).double()

        def centre(x: Tensor, origin: State, uv: Tensor = uv, t: int = target, h: int = host, p: int = p) -> Tensor:
            s = origin.moved(x)
            return warp(CAMERA, uv, s.inv_depth[h, p], s.relative(t, h)).centre

        T, d = state.relative(target, host), state.inv_depth[host, p]
        pattern = WIDE_PATTERN if noise.pattern == WIDE else PATTERN
        warped = warp(CAMERA, uv, d, T, pattern, torch.from_numpy(points.slope[host, p]))
        value, g, inside = sample_with_gradient(image, warped.uv)
        delta_A = projective_distortion(d, warped.P, T)
        if not inside.all() or delta_A <= 0:
            continue
        dp = jacfwd(lambda q, d=d, T=T: warp(CAMERA, q, d, T).centre)(uv)
        moved = g_host @ torch.linalg.inv(dp)  # (dp_i/dp_j)^-T g
        phi = photometric_variance(
            moved, torch.zeros(2).double(), 0.0, sigma_intensity=noise.var_intensity**0.5,
            sigma_pixel=(noise.var_pixel / P) ** 0.5, shared=P,
        )  # fmt: skip
        variance = residual_variance(distortion_weight(delta_A, noise.c_h)[0], phi)
        g = (1 - noise.gradient_blend) * g + noise.gradient_blend * moved

        def brightness(x: Tensor, t: int = target, h: int = host, patch: Tensor = patch) -> Tensor:
            (a_t, b_t), (a_h, b_h) = state.moved(x).affine[[t, h]]
            return (a_t - a_h).exp() * (patch - b_h) + b_t

        r = value - brightness(zero)
        rms[host, p, target] = float((r**2 / variance).mean().sqrt())
        if rms[host, p, target] > limit:
            energy += P * limit**2
            continue
        # the image is linear about the point, with the blended gradient
        energy += add(lambda x, g=g, f=brightness, c=centre: g @ c(x, at_linear) - f(x), r, variance, torch.inf)
        measured, g_depth, on_surface = sample_surface(torch.where(depth > 0, 1 / depth, 0.0), warped.centre, 0.05)
        if noise.use_depth and on_surface:

            def gap(x: Tensor, g: Tensor = g_depth, c: Callable[..., Tensor] = centre, uv: Tensor = uv,
                    t: int = target, h: int = host, p: int = p) -> Tensor:  # fmt: skip
                s = at_linear.moved(x)
                return (g * c(x, at_linear)).sum() - 1 / warp(CAMERA, uv, s.inv_depth[h, p], s.relative(t, h)).P[2]

            variance = noise.var_depth + noise.var_pixel * g_depth.square().sum()
            r = measured - 1 / warped.P[2]
            energy += add(lambda x, f=gap: f(x)[None], r[None], variance[None], 6 * noise.huber)
    return *system, energy, rms


@pytest.mark.parametrize(
    ("limit", "use_depth", "pairs", "first_estimates"),
    [
        (1e9, True, [[1, 1, 1]] * 3, True),
        (2.0, True, [[1, 1, 1], [0, 0, 0], [1, 1, 1]], False),
        (2.0, False, [[0, 0, 1], [1, 1, 1], [0, 1, 0]], True),
    ],
)
def test_window_is_the_chain_rule(
    scene: Scene, limit: float, use_depth: bool, pairs: list[list[int]], first_estimates: bool
) -> None:
    noise = kernel_noise(
        NoiseConfig(depth_residual=use_depth, gradient_blend=0.3, sigma_pixel=0.3),
        pattern=WIDE if use_depth else COMPACT,
    )
    linear = scene.linear if first_estimates else scene.state
    taking_part = np.array(pairs, dtype=np.bool_)
    H, b, energy, rms = fused(scene, linear, taking_part, limit, noise)
    H_true, b_true, energy_true, rms_true = by_definition(scene, linear, taking_part, limit, noise)
    unit = torch.where(H_true.diagonal() > 0, H_true.diagonal(), 1.0).rsqrt()
    torch.testing.assert_close(unit[:, None] * H * unit, unit[:, None] * H_true * unit, rtol=0, atol=1e-10)
    torch.testing.assert_close(unit * b, unit * b_true, rtol=0, atol=1e-10 * float((unit * b_true).abs().max()))
    assert energy == pytest.approx(energy_true, rel=1e-10)
    np.testing.assert_allclose(rms, rms_true, rtol=1e-10)
    seen = rms >= 0
    assert seen.sum() >= 2.5 * (np.sum(pairs) - np.trace(pairs)) and (not seen.all())
    assert limit > 1e3 or 0 < (rms[seen] > limit).sum() < seen.sum()


def test_moving_everything_together_costs_nothing(scene: Scene) -> None:
    """The gauge: a common motion of all keyframes is free, and only that, besides brightness."""
    noise = kernel_noise(NoiseConfig())
    H, _, _, _ = fused(scene, scene.state, np.ones((K, K), dtype=np.bool_), 1e9, noise)
    poses = torch.arange(STEP * K) % STEP < 6
    together = se3.adjoint(scene.state.T).reshape(6 * K, 6)  # of a world that moves by xi: T exp(xi)
    step = torch.zeros(len(H), 6, dtype=torch.float64)
    step[: STEP * K][poses] = together
    assert (H @ step).abs().max() < 1e-9 * H.abs().max()
    assert float(step[:, 0] @ H @ step[:, 0]) < 1e-12 * float(step[:6, 0] @ H[:6, :6] @ step[:6, 0])


def test_eliminating_the_depths_is_dense_elimination(scene: Scene) -> None:
    noise = kernel_noise(NoiseConfig())
    H, b, _, _ = fused(scene, scene.state, np.ones((K, K), dtype=np.bool_), 1e9, noise)
    n = STEP * K
    Hd, bd = H.diagonal()[n:].reshape(K, N), b[n:].reshape(K, N)
    system = WindowSystem.empty(K, N)
    parts = (H[:n, :n], b[:n], Hd, bd, H[n:, :n].reshape(K, N, n).mT)
    for part, values in zip(system[:5], parts, strict=True):
        part[...] = values.numpy()
    reduced, rhs = eliminate_depths(system)
    known = H.diagonal() > 0
    known[:n] = False
    expected = H[:n, :n] - H[:n, known] @ torch.linalg.solve(H[known][:, known], H[known, :n])
    torch.testing.assert_close(torch.from_numpy(reduced), expected, rtol=0, atol=1e-12 * float(H[:n, :n].abs().max()))
    expected = b[:n] - H[:n, known] @ torch.linalg.solve(H[known][:, known], b[known])
    torch.testing.assert_close(torch.from_numpy(rhs), expected, rtol=0, atol=1e-12 * float(b[:n].abs().max()))


def test_what_pairs_said_goes_along_with_the_state(scene: Scene) -> None:
    """The energy changes with every variable as the right sides say, and is nearly what it is at a state nearby."""
    noise, limit = kernel_noise(NoiseConfig(gradient_blend=0.0)), 1e9
    everything = np.ones((K, K), dtype=np.bool_)

    def at(state: State, taken: WindowPairs | None = None) -> tuple[float, WindowSystem, WindowPairs]:
        arrays = as_arrays(state, state)
        if taken is None:
            taken = WindowPairs.empty(K, N)
            linearise_window(views(scene), arrays, scene.points, everything, limit, noise, taken)
        system = WindowSystem.empty(K, N)
        return assemble(taken, arrays, scene.points, everything, system), system, taken

    _, start, taken = at(scene.state)
    rhs = np.concatenate([start.b, start.bd.ravel()])
    diagonal = np.concatenate([np.diag(start.H), start.Hd.ravel()])
    for k in np.flatnonzero(diagonal > 0):
        step = torch.zeros(len(rhs), dtype=torch.float64)
        step[k] = 1e-3 / diagonal[k] ** 0.5
        more, less = (at(scene.state.moved(sign * step), taken)[0] for sign in (1, -1))
        assert (more - less) / (2 * step[k]) == pytest.approx(-2 * rhs[k], rel=1e-3, abs=1e-4 * diagonal[k] ** 0.5)

    step = torch.from_numpy(np.random.default_rng(0).standard_normal(len(rhs)) / np.sqrt(np.maximum(diagonal, 1e-9)))
    step[torch.from_numpy(diagonal == 0)] = 0.0
    moved = scene.state.moved(step)
    (energy, _, _), (expected, _, fresh) = at(moved, taken), at(moved)
    assert energy == pytest.approx(expected, rel=0.01)
    far = distances(taken, as_arrays(moved, moved))
    assert (far[~np.eye(K, dtype=np.bool_)] > 0).all() and (np.diag(far) == 0).all()
    assert (distances(fresh, as_arrays(moved, moved)) < 1e-12).all()
    two = WindowPairs(*(array[:2, :2] for array in taken))
    one_more = distances(two.grown(), as_arrays(moved, moved))
    np.testing.assert_array_equal(one_more[:2, :2], far[:2, :2])
    assert np.isinf(one_more[2, :2]).all() and np.isinf(one_more[:2, 2]).all() and one_more[2, 2] == 0
