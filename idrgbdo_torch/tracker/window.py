"""Sliding-window photometric bundle adjustment over poses, brightness and inverse depths (section 5.2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..config import Config
from ..definitions.marginalization import LinearPrior, marginalize, prior_cost, prior_gradient, redundancy_bits
from ..frame import Keyframe
from ..kernels.se3 import inverse, log_se3, retract
from ..kernels.solver import solve_spd
from ..measurement import Noise, WindowPoints
from .backends import FUSED, Backend, backend_named

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FIXED = np.array(
    [1e10] * 3 + [1e10] * 3 + [1e6, 1e2]
)  # information that holds the first keyframe: gauge and brightness
BRIGHTNESS = np.array([0.0] * 6 + [1.0 / 0.2**2, 1.0 / 20.0**2])  # weak prior of every other keyframe
ITERATIONS = 4
SETTLED = 1.0  # standard deviations; a smaller step ends the optimisation
TOLERANCE = (
    1.02  # a step may raise the cost so much: points crossing a limit make it jump by more than the step is worth
)
PROTECTED = 2  # newest keyframes that redundancy may not remove
STEP = 8  # numbers a keyframe: [v, w], a, b


class Window:
    """The newest keyframes with their refined poses; state of the system lives here and in IdRgbdo only."""

    def __init__(self, config: Config, noise: Noise) -> None:
        self.config = config
        self.noise = noise
        self.backend = backend_named(config.backend)
        self.keyframes: list[Keyframe] = []
        self.index: list[Index] = []  # window points of every keyframe, among its candidates
        self.T_kf_world = np.zeros((0, 4, 4))
        self.T_linear = np.zeros((0, 4, 4))  # linearisation points, first estimates once in the prior
        self.affine = np.zeros((0, 2))
        self.affine_linear = np.zeros((0, 2))
        self.in_prior = np.zeros(0, dtype=np.bool_)
        self.inv_depth = np.zeros((0, config.window_points))
        self.prior = LinearPrior(torch.zeros(0, 0, dtype=torch.float64), torch.zeros(0, dtype=torch.float64))
        self.scale = 1.0  # robust scale of the whitened residuals when the last optimisation ended
        self.slots = np.zeros(0, dtype=np.int64)
        self.images = np.zeros((0, 0, 0), dtype=np.float32)
        self.depths = np.zeros((0, 0, 0), dtype=np.float32)

    def add(self, keyframe: Keyframe, T_kf_world: Array, relative: Array, index: Index) -> None:
        """Append a keyframe at its tracked pose, with its brightness (2,) relative to the newest one so far.

        index: the chosen window points (<= config.window_points,).
        """
        affine = np.zeros(2)
        if self.keyframes:
            a, b = self.affine[-1]
            affine = np.array([a + relative[0], np.exp(relative[0]) * b + relative[1]])
        capacity = self.config.window.keyframes + 1
        height, width = keyframe.frame.depth.shape
        if self.images.shape != (capacity, height, width):
            self.images = np.zeros((capacity, height, width), dtype=np.float32)
            self.depths = np.zeros((capacity, height, width), dtype=np.float32)
        slot = next(s for s in range(capacity) if s not in self.slots)
        self.images[slot] = keyframe.frame.images[0]
        self.depths[slot] = keyframe.frame.depth
        first = not self.keyframes
        self.keyframes.append(keyframe)
        self.index.append(index)
        self.slots = np.append(self.slots, slot)
        self.T_kf_world = np.concatenate([self.T_kf_world, T_kf_world[None]])
        self.T_linear = np.concatenate([self.T_linear, T_kf_world[None]])
        self.affine = np.concatenate([self.affine, affine[None]])
        self.affine_linear = np.concatenate([self.affine_linear, affine[None]])
        self.in_prior = np.append(self.in_prior, first)
        row = np.zeros((1, self.config.window_points))
        row[0, : len(index)] = keyframe.points.inv_depth[index]
        self.inv_depth = np.concatenate([self.inv_depth, row])
        n = STEP * len(self.keyframes)
        H = torch.zeros(n, n, dtype=torch.float64)
        b = torch.zeros(n, dtype=torch.float64)
        H[:-STEP, :-STEP] = self.prior.H
        b[:-STEP] = self.prior.b
        H.diagonal()[-STEP:] = torch.from_numpy(FIXED if first else BRIGHTNESS)
        self.prior = LinearPrior(H, b)

    def points(self) -> WindowPoints:
        """The window points of all keyframes as padded arrays."""
        K, N, P = len(self.keyframes), self.config.window_points, self.config.tracking.patch
        out = WindowPoints(
            np.zeros((K, N, 2)), np.zeros((K, N, P), np.float32), np.zeros((K, N, P, 2), np.float32),
            np.ones((K, N)), np.ones((K, N)), np.zeros((K, N), np.bool_),
        )  # fmt: skip
        for k, (keyframe, index) in enumerate(zip(self.keyframes, self.index, strict=True)):
            n = len(index)
            out.uv[k, :n] = keyframe.points.uv[index]
            out.patch[k, :n] = keyframe.points.patch[0, index]
            out.gradient[k, :n] = keyframe.points.gradient[0, index]
            out.measured[k, :n] = keyframe.measured[index]
            out.variance[k, :n] = keyframe.measured_variance[index]
            out.valid[k, :n] = True
        return out

    def deviation(self) -> torch.Tensor:
        """(8K,) of the state from the linearisation points: log(T T_0^-1) and brightness."""
        out = np.zeros((len(self.keyframes), STEP))
        for k in range(len(self.keyframes)):
            out[k, :6] = log_se3(self.T_kf_world[k] @ inverse(self.T_linear[k]))
        out[:, 6:] = self.affine - self.affine_linear
        return torch.from_numpy(out.ravel())

    def linearise(self, points: WindowPoints, hosts: NDArray[np.bool_], limit: float) -> tuple[float, Linearised]:
        """Cost and normal equations of the points of some hosts at the present state (no prior)."""
        K, N = self.inv_depth.shape
        fixed = self.in_prior if self.config.window.first_estimates else np.zeros(K, dtype=np.bool_)
        T_linear = np.where(fixed[:, None, None], self.T_linear, self.T_kf_world)
        out = Linearised(K, N, self.backend)
        energy = self.backend.bundle.linearise_window(
            self.images, self.depths, self.slots, self.keyframes[0].frame.intrinsics[0], self.T_kf_world, T_linear,
            self.affine, self.inv_depth, points, hosts, limit, self.noise,
            out.H, out.b, out.Hd, out.cross, out.bd, out.rms,
        )  # fmt: skip
        return energy, out

    def optimise(self) -> int:
        """Damped Gauss-Newton over the whole window; returns the iterations."""
        K = len(self.keyframes)
        if K < 2:
            return 0
        points = self.points()
        everyone = np.ones(K, dtype=np.bool_)
        limit = self.config.noise.outlier * self.scale
        energy, system = self.linearise(points, everyone, limit)
        energy += 2.0 * float(prior_cost(self.prior, self.deviation()))
        damping = 0.0
        iteration = 0
        while iteration < ITERATIONS:
            iteration += 1
            H, b = system.reduced()
            H += self.prior.H.numpy()
            b += prior_gradient(self.prior, self.deviation()).numpy()
            H[np.diag_indices_from(H)] *= 1.0 + damping
            H[np.diag_indices_from(H)] += 1e-9
            solved, step = solve_spd(H, b)
            if not solved:
                break
            depth_step = system.depth_step(step)
            saved = (self.T_kf_world, self.affine, self.inv_depth)
            self.T_kf_world = np.stack([retract(step[STEP * k : STEP * k + 6], saved[0][k]) for k in range(K)])
            self.affine = saved[1] + step.reshape(K, STEP)[:, 6:]
            self.inv_depth = saved[2] + depth_step
            new_energy, new_system = self.linearise(points, everyone, limit)
            new_energy += 2.0 * float(prior_cost(self.prior, self.deviation()))
            if np.isfinite(new_energy) and new_energy <= energy * TOLERANCE:
                energy, system = new_energy, new_system
                damping *= 0.25
            else:
                self.T_kf_world, self.affine, self.inv_depth = saved
                damping = max(4.0 * damping, 1e-2)
            if step @ b < SETTLED**2:
                break
        self.scale = max(1.0, self.backend.alignment.robust_scale(system.rms.ravel()))
        self._refresh_points(system)
        self.system = system
        return iteration

    def _refresh_points(self, system: Linearised) -> None:
        """Hand the refined inverse depths to the keyframes, where tracking reads them."""
        for k, (keyframe, index) in enumerate(zip(self.keyframes, self.index, strict=True)):
            n = len(index)
            inv_depth = keyframe.points.inv_depth.copy()
            variance = keyframe.points.var_inv_depth.copy()
            inv_depth[index] = self.inv_depth[k, :n]
            variance[index] = 1.0 / np.maximum(system.Hd[k, :n], 1e-9)
            self.keyframes[k] = replace(
                keyframe, points=keyframe.points._replace(inv_depth=inv_depth, var_inv_depth=variance)
            )

    def shrink(self) -> list[tuple[int, Keyframe]]:
        """Marginalise keyframes until at most window.keyframes are left; returns them, with their places at removal."""
        removed = []
        while len(self.keyframes) > self.config.window.keyframes:
            k = self.least_useful()
            removed.append((k, self.keyframes[k]))
            self.marginalise(k)
        return removed

    def least_useful(self) -> int:
        """The keyframe to remove: one that the newest hardly sees, else the most redundant by Eq. 26."""
        K = len(self.keyframes)
        seen = (self.system.rms[:, :, -1] >= 0.0).sum(axis=1) / np.maximum([len(i) for i in self.index], 1)
        for k in range(K - PROTECTED):
            if seen[k] < 0.05:
                return k
        if self.config.window.removal == "oldest":
            return 0
        H, b = self.system.reduced()
        H += self.prior.H.numpy()
        poses = self._without(H, b, np.arange(STEP * K) % STEP >= 6).H
        ok, psi = self.backend.marginal.redundancy(poses.numpy())
        if not ok:
            psi = redundancy_bits(poses).numpy()
        return int(psi[: K - PROTECTED].argmax())

    def _without(self, H: Array, b: Array, marginal: NDArray[np.bool_]) -> LinearPrior:
        """marginalize(), by the backend's twin where nothing is singular."""
        keep, gone = np.flatnonzero(~marginal), np.flatnonzero(marginal)
        ok, H_star, b_star = self.backend.marginal.marginalize(H, b, keep, gone)
        if ok:
            return LinearPrior(torch.from_numpy(H_star), torch.from_numpy(b_star))
        return marginalize(torch.from_numpy(H), torch.from_numpy(b), torch.from_numpy(marginal))

    def marginalise(self, k: int) -> None:
        """Replace a keyframe's points, then the keyframe itself, by a linear prior on the others (Eqs. 21 to 25)."""
        K = len(self.keyframes)
        hosts = np.arange(K) == k
        limit = self.config.noise.outlier
        _, system = self.linearise(self.points(), hosts, limit)
        H, b = system.reduced()
        touched = np.abs(H).reshape(K, STEP, -1).sum(axis=(1, 2)) > 0.0
        fresh = touched & ~self.in_prior
        self.T_linear[fresh] = self.T_kf_world[fresh]
        # brightness is linear enough; poses keep their first estimate. b is taken back to the linearisation point
        delta = self.deviation().numpy()
        H_all = H + self.prior.H.numpy()
        b_all = b + H @ delta + self.prior.b.numpy()
        self.prior = self._without(H_all, b_all, np.repeat(hosts, STEP))
        keep = ~hosts
        self.in_prior = (self.in_prior | touched)[keep]
        self.keyframes.pop(k)
        self.index.pop(k)
        self.slots = self.slots[keep]
        self.T_kf_world = self.T_kf_world[keep]
        self.T_linear = self.T_linear[keep]
        self.affine = self.affine[keep]
        self.affine_linear = self.affine_linear[keep]
        self.inv_depth = self.inv_depth[keep]


class Linearised:
    """Normal equations of a window, inverse depths still apart."""

    def __init__(self, K: int, N: int, backend: Backend = FUSED) -> None:
        self.backend = backend
        self.H = np.zeros((STEP * K, STEP * K))
        self.b = np.zeros(STEP * K)
        self.Hd = np.zeros((K, N))
        self.bd = np.zeros((K, N))
        self.cross = np.zeros((K, N, STEP * K))
        self.rms = np.zeros((K, N, K))

    def reduced(self) -> tuple[Array, Array]:
        """Inverse depths eliminated by the Schur complement (their block is diagonal)."""
        H, b = self.backend.bundle.eliminate_depths(self.H, self.b, self.Hd, self.cross, self.bd)
        return H, b

    def depth_step(self, step: Array) -> Array:
        """Back-substitution: the inverse depths' step for a step of poses and brightness."""
        out: Array = (self.bd - self.cross @ step) / np.where(self.Hd > 0.0, self.Hd, np.inf)
        return out
