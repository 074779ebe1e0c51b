"""Sliding-window photometric bundle adjustment over poses, brightness and inverse depths (section 5.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ..config import Config
from ..definitions.marginalization import LinearPrior, prior_cost, prior_gradient
from ..frame import Keyframe
from ..kernels.se3 import adjoints_to_last, increments, retracted
from ..kernels.solver import solve_spd
from ..measurement import STEP, Noise, Views, WindowSystem
from .backends import Backend
from .members import Members
from .smoothing import Departure, departure

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FIXED = np.array(
    [1e10] * 3 + [1e10] * 3 + [1e6, 1e2]
)  # information that holds the first keyframe: gauge and brightness
BRIGHTNESS = np.array([0.0] * 6 + [1.0 / 0.2**2, 1.0 / 20.0**2])  # weak prior of every other keyframe
ITERATIONS = 2  # the next keyframe goes on
SETTLED = 1.0  # standard deviations; a smaller step ends the optimisation
TOLERANCE = (
    1.02  # a step may raise the cost so much: points crossing a limit make it jump by more than the step is worth
)
NEAR = 1.0  # standard deviations that a pair may move before it is linearised again
SMALLEST_SYSTEM = 1e-9  # added to the diagonal: what nothing measures does not move
SLOTS = 16  # images of a window are a multiple of this many
PROTECTED = 2  # newest keyframes that stay
HARDLY_SEEN = 0.05  # share of a keyframe's points in the newest view under which it goes first


class Solved(NamedTuple):
    """How an optimisation ended."""

    system: WindowSystem
    reduced: Array  # (8K, 8K) of poses and brightness with the prior, as its last step was solved


class Window:
    """The newest keyframes with their refined poses, brightness and inverse depths, and what older ones left behind."""

    def __init__(self, config: Config, noise: Noise, backend: Backend) -> None:
        self.config = config
        self.noise = noise
        self.backend = backend
        self.members = Members.none(config.window_points, config.tracking.patch)
        self.prior = LinearPrior(torch.zeros(0, 0, dtype=torch.float64), torch.zeros(0, dtype=torch.float64))
        self.scale = 1.0  # robust scale of the whitened residuals when the last optimisation ended
        self.solved = Solved(WindowSystem.empty(0, 0), np.zeros((0, 0)))

    def add(self, keyframe: Keyframe, T_kf_world: Array, relative: Array, index: Index) -> None:
        """Append a keyframe at its tracked pose, with its brightness (2,) relative to the newest one so far.

        index: the chosen window points (<= config.window_points,).
        """
        affine = np.zeros(2)
        if self.members:
            a, b = self.members.affine[-1]
            affine = np.array([a + relative[0], np.exp(relative[0]) * b + relative[1]])
        n = len(self.prior.b)
        H, b = np.zeros((n + STEP, n + STEP)), np.zeros(n + STEP)
        H[:n, :n], b[:n] = self.prior.H.numpy(), self.prior.b.numpy()
        np.einsum("ii->i", H)[n:] = BRIGHTNESS if self.members else FIXED
        self.prior = LinearPrior(torch.from_numpy(H), torch.from_numpy(b))
        self.members = self.members.append(keyframe, index, T_kf_world, affine)

    def views(self) -> Views:
        """What the keyframes show; some images again, as kernels are compiled for each number of them anew."""
        frames = [keyframe.frame for keyframe in self.members.keyframes]
        frames += frames[:1] * (-len(frames) % SLOTS)
        images, depths = tuple(frame.images[0] for frame in frames), tuple(frame.depth for frame in frames)
        return Views(images, depths, frames[0].intrinsics[0])

    def deviation(self) -> torch.Tensor:
        """(8K,) of the state from the linearisation points: log(T T_0^-1) and brightness."""
        members = self.members
        out = np.empty((len(members.keyframes), STEP))
        out[:, :6] = increments(members.T, members.T_linear)
        out[:, 6:] = members.affine - members.affine_linear
        return torch.from_numpy(out.ravel())

    def linearise(self, which: NDArray[np.bool_], limit: float) -> None:
        """Take some pairs (K, K) of host and target at the present state."""
        members = self.members
        state = members.state(self.config.window.first_estimates)
        self.backend.linearise_window(self.views(), state, members.points, which, limit, self.noise, members.pairs)

    def take(self, limit: float) -> bool:
        """Take pairs that are new, or have moved too far for what they said; whether there were any."""
        far = self.backend.distances(self.members.pairs, self.members.state(False)) > NEAR**2
        if some := bool(far.any()):
            self.linearise(far, limit)
        return some

    def assemble(self, which: NDArray[np.bool_]) -> tuple[float, WindowSystem]:
        """Cost and normal equations of some pairs (K, K) at the present state, as they were taken."""
        return self.backend.assemble(self.members.pairs, self.members.state(False), self.members.points, which)

    def equations(self) -> tuple[float, WindowSystem]:
        """Cost at the present state, and normal equations without the prior's."""
        energy, system = self.assemble(np.ones_like(self.members.pairs.taken))
        return energy + self.prior_energy(), system

    def optimise(self) -> int:
        """Damped Gauss-Newton over the whole window; returns the iterations."""
        if len(self.members.keyframes) < 2:
            return 0
        limit = self.config.noise.outlier * self.scale
        self.take(limit)
        energy, system = self.equations()
        damping = 0.0
        iteration = 0
        while iteration < ITERATIONS:
            iteration += 1
            H, b = self.backend.eliminate_depths(system)
            H += self.prior.H.numpy()
            b += prior_gradient(self.prior, self.deviation()).numpy()
            reduced = H.copy()
            diagonal = np.einsum("ii->i", H)  # a view
            diagonal *= 1.0 + damping
            diagonal += SMALLEST_SYSTEM
            solved, step = solve_spd(H, b)
            if not solved:
                break
            saved = self.members
            self.members = moved(saved, step, depth_step(system, step))
            if not self.take(limit):
                break  # the same equations, which are solved
            new_energy, there = self.equations()
            if np.isfinite(new_energy) and new_energy <= energy * TOLERANCE:
                energy, system = new_energy, there
                damping *= 0.25
            else:
                self.members = saved
                self.take(limit)
                energy, system = self.equations()
                damping = max(4.0 * damping, 1e-2)
            if step @ b < SETTLED**2:
                break
        self.scale = max(1.0, self.backend.robust_scale(self.members.pairs.rms.ravel()))
        self.members = with_refined_points(self.members, system)
        self.solved = Solved(system, reduced)
        return iteration

    def prior_energy(self) -> float:
        """What the prior adds to the cost."""
        return 2.0 * float(prior_cost(self.prior, self.deviation()))

    def shrink(self) -> list[tuple[int, Keyframe, Departure]]:
        """Marginalise keyframes until at most window.keyframes are left; returns their places at removal, and how."""
        removed = []
        while len(self.members.keyframes) > self.config.window.keyframes:
            information = self.pose_information()
            k = self.least_useful(information)
            removed.append((k, self.members.keyframes[k], departure(self.members.T, information, k)))
            self.marginalise(k)
        return removed

    def pose_information(self) -> Array:
        """(6K, 6K) of the poses in the last optimisation, with the prior; depths and brightness are marginal."""
        n = len(self.solved.reduced)
        return self.backend.marginalize(self.solved.reduced, np.zeros(n), np.arange(n) % STEP >= 6).H.numpy()

    def least_useful(self, information: Array) -> int:
        """The keyframe to remove: one that the newest hardly sees, else as configured; never one of the newest.

        information: (6K, 6K) of the poses.
        """
        members = self.members
        K = len(members.keyframes)
        seen = (self.members.pairs.rms[:, -1] >= 0.0).sum(axis=1) / np.maximum([len(i) for i in members.chosen], 1)
        for k in range(K - PROTECTED):
            if seen[k] < HARDLY_SEEN:
                return k
        if self.config.window.removal == "oldest":
            return 0
        if self.config.window.removal == "view":
            return int(self.next_view_bits(information)[: K - PROTECTED].argmin())
        psi = self.backend.redundancy(information)
        return int(psi[: K - PROTECTED].argmax())

    def move_world(self, T_old_new: Array) -> None:
        """See everything from another world, which lies at this pose (4, 4); the prior stays as it is."""
        members = self.members
        self.members = members._replace(T=members.T @ T_old_new, T_linear=members.T_linear @ T_old_new)

    def next_view_bits(self, information: Array) -> Array:
        """What a view where the newest keyframe is would lose with each keyframe (K,), in bits.

        It is taken to be measured against the others as the newest is, and against the newest as that one against its
        neighbour: of normal equations, the block of two keyframes is -A times the adjoint, with A the information of
        one against the other.
        """
        T, K = self.members.T, len(self.members.keyframes)
        adjoints = adjoints_to_last(T)
        blocks = self.solved.system.H.reshape(K, STEP, K, STEP)[-1, :6, :, :6].transpose(1, 0, 2)
        links = -blocks @ np.linalg.inv(adjoints)
        links[-1] = links[-2]
        values, vectors = np.linalg.eigh(0.5 * (links + links.transpose(0, 2, 1)))
        links = (vectors * np.maximum(values, 0.0)[:, None]) @ vectors.transpose(
            0, 2, 1
        )  # by rounding they may fall short
        bits = self.backend.next_view_bits(information, links, adjoints)
        return np.where(np.isfinite(bits), bits, 0.0)

    def marginalise(self, k: int) -> None:
        """Replace a keyframe's points, then the keyframe itself, by a linear prior on the others (Eqs. 21 to 25)."""
        K = len(self.members.keyframes)
        hosts = np.arange(K) == k
        pairs = np.repeat(hosts[:, None], K, axis=1)
        _, system = self.assemble(pairs)
        H, b = self.backend.eliminate_depths(system)
        touched = np.abs(H).reshape(K, STEP, -1).sum(axis=(1, 2)) > 0.0
        fresh = touched & ~self.members.in_prior
        self.members.T_linear[fresh] = self.members.T[fresh]
        # brightness is linear enough; poses keep their first estimate. b is taken back to the linearisation point
        delta = self.deviation().numpy()
        H_all = H + self.prior.H.numpy()
        b_all = b + H @ delta + self.prior.b.numpy()
        self.prior = self.backend.marginalize(H_all, b_all, np.repeat(hosts, STEP))
        self.members = self.members._replace(in_prior=self.members.in_prior | touched).keep(~hosts)


def moved(members: Members, step: Array, depth_step: Array) -> Members:
    """The members after increments: step (8K,) of poses and brightness, depth_step (K, N) of inverse depths."""
    by_keyframe = step.reshape(-1, STEP)
    T = retracted(by_keyframe[:, :6], members.T)
    affine = members.affine + by_keyframe[:, 6:]
    return members._replace(T=T, affine=affine, inv_depth=members.inv_depth + depth_step)


def depth_step(system: WindowSystem, step: Array) -> Array:
    """Back-substitution: the inverse depths' step (K, N) for a step (8K,) of poses and brightness."""
    out: Array = (system.bd - step @ system.cross) / np.where(system.Hd > 0.0, system.Hd, np.inf)
    return out


def with_refined_points(members: Members, system: WindowSystem) -> Members:
    """The refined inverse depths handed to the keyframes, where tracking reads them."""
    keyframes = []
    for k, (keyframe, index) in enumerate(zip(members.keyframes, members.chosen, strict=True)):
        n = len(index)
        inv_depth = keyframe.points.inv_depth.copy()
        variance = keyframe.points.var_inv_depth.copy()
        inv_depth[index] = members.inv_depth[k, :n]
        variance[index] = 1.0 / np.maximum(system.Hd[k, :n], 1e-9)
        keyframes.append(
            replace(keyframe, points=keyframe.points._replace(inv_depth=inv_depth, var_inv_depth=variance))
        )
    return members._replace(keyframes=tuple(keyframes))
