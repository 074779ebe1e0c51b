"""Pose of a frame against its keyframe (section 4.2): prediction, prior, alignment, verification, recovery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from .config import Config, NoiseConfig
from .frame import LEVELS, Frame, Keyframe
from .kernels import alignment, choice
from .kernels.lie import inverse, log_se3, retract
from .kernels.model import Noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEPS = np.array([8, 10, 12, 12, 12, 12])  # most iterations per level, finest first
AFFINE_PRIOR = np.diag([1.0 / 0.1**2, 1.0 / 10.0**2])  # of gain and gray levels, about the previous frame's
RATE = 30.0  # Hz, at which the motion prior is given
VERIFIED_LEVEL = 1
VERIFIED_GRAY = 12.0  # gray levels, largest residual of a point that agrees
GAIN_LIMIT = 1.0  # of the logarithm: with no contrast left, a black or a white image would explain everything


def motion_prior_terms(xi_frame: Tensor, xi_predicted: Tensor, information: Tensor) -> tuple[Tensor, Tensor]:
    """Eq. (19). What the motion prior adds to the normal equations: Sigma_m^-1 and Sigma_m^-1 (x_{t-1} - x_t^(k)).

    xi_frame (..., 6): the frame's motion at this iteration, xi_predicted (..., 6): the previous frame's motion (both
    log(T_t T_{t-1}^-1), constant velocity), information (6, 6): Sigma_m^-1. The prior belongs to the cost that a step
    must lower, not to the entropy that is reported.
    """
    return information, (information @ (xi_predicted - xi_frame)[..., None])[..., 0]


def motion_information(config: Config, dt: float) -> Array:
    """Sigma_m^-1 (6, 6) for a gap of dt seconds: a change of velocity moves the camera by its size times dt."""
    growth = (RATE * dt) * dt
    sigma_v = config.tracking.sigma_velocity * growth
    sigma_w = config.tracking.sigma_turn * growth
    return np.diag([1.0 / sigma_v**2] * 3 + [1.0 / sigma_w**2] * 3)


def kernel_noise(config: NoiseConfig) -> Noise:
    """NoiseConfig as the plain numbers that the kernels read."""
    shared = float(choice.PIXELS)
    return Noise(
        var_intensity=config.sigma_intensity**2,
        var_pixel=shared * config.sigma_pixel**2,
        var_depth=(config.sigma_disparity / config.focal_baseline) ** 2,
        shared=shared,
        c_h=config.c_h,
        huber=config.huber / config.sigma_intensity,
        outlier=config.outlier,
        use_depth=config.depth_residual,
        paper_variance=config.variance == "paper",
        gradient_blend=config.gradient_blend,
    )


def with_blur(noise: Noise, config: NoiseConfig, focal: float, turn: Array, turn_kf: Array) -> Noise:
    """The noise of a frame that turns (3,) rad/s against a keyframe that turned otherwise.

    Both images are smeared along their own motion; an edge smeared differently seems to lie elsewhere.
    """
    speed = focal * float(np.linalg.norm(turn - turn_kf)) / RATE  # px a frame
    return noise._replace(var_pixel=noise.var_pixel + noise.shared * (config.blur * speed) ** 2)


def turn_rate(T_new: Array, T_old: Array, dt: float) -> Array:
    """Angular velocity (3,) rad/s between two cam_world poses dt seconds apart."""
    turn: Array = log_se3(T_new @ inverse(T_old))[3:] / dt
    return turn


@dataclass(frozen=True)
class Tracked:
    """One alignment to a keyframe."""

    T_frame_kf: Array  # (4, 4)
    affine: Array  # (2,) a, b of the frame relative to the keyframe
    information: Array  # (6, 6) of a left increment of T_frame_kf, brightness marginalised, prior excluded
    points: int  # used
    iterations: int
    index: Index  # chosen candidates
    rms: Array  # whitened residual of each, -1 unseen


def predict(T_a: Array, T_b: Array, ratio: float) -> Array:
    """Constant velocity: the motion from T_b to T_a (cam_world poses), times ratio, once more from T_a."""
    T: Array = retract(ratio * log_se3(T_a @ inverse(T_b)), T_a)
    return T


def track_frame(
    frame: Frame, keyframe: Keyframe, T_guess: Array, affine: Array, index: Index, coarse: Index, prior: Array,
    noise: Noise, levels: int,
) -> Tracked:  # fmt: skip
    """Align a frame to a keyframe from a guess of T_frame_kf, with the motion prior's information (6, 6) about it."""
    T, affine, H, rms, _scale, iterations, _seen, kept, _change = alignment.align(
        frame.images, frame.depth, keyframe.frame.intrinsics, keyframe.points, coarse, index,
        T_guess, affine, prior, inverse(T_guess), AFFINE_PRIOR, noise, STEPS[:levels],
    )  # fmt: skip
    return Tracked(T, affine, pose_information(H), int(kept), int(iterations), index, rms)


def pose_information(H: Array) -> Array:
    """(6, 6): brightness (last two) marginalised from the (8, 8) normal matrix."""
    out: Array = H[:6, :6] - H[:6, 6:] @ np.linalg.solve(H[6:, 6:], H[6:, :6])
    return 0.5 * (out + out.T)


@dataclass(frozen=True)
class Verdict:
    """How well a pose explains a few hundred points that did not choose it."""

    visible: float  # share of the points that the frame sees
    bright: float  # share of those with agreeing brightness
    near: float  # share of those with depth that agree in depth

    @property
    def score(self) -> float:
        """For the choice between two poses."""
        return self.visible * self.bright * self.near

    def doubt(self, strict: float) -> str:
        """Why the pose is not to be believed, empty when it is; strict grows the limits towards 1."""
        if self.visible < 0.15:
            return f"only {self.visible:.0%} of the keyframe is in view"
        if self.bright < strict:
            return f"only {self.bright:.0%} of the points agree in brightness"
        if self.near < strict + 0.12:
            return f"only {self.near:.0%} of the points agree in depth"
        return ""


WEAK_BELOW = 0.61  # share of agreeing points under which a pose is doubtful
LOST_BELOW = 0.54  # and under which it is not used
UNSURE_BITS = -7.0  # entropy of the least certain degree of freedom, about 2 mm or 2 mrad given the others
FREEDOMS = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")


def unsure(entropies: Tensor) -> str:
    """Why a pose with these entropies (6,) in bits is doubtful however well it fits, empty when it is not."""
    worst = int(entropies.argmax())
    if entropies[worst] <= UNSURE_BITS:
        return ""
    return f"{FREEDOMS[worst]} is uncertain: {entropies[worst]:.1f} bits"


def verify(frame: Frame, keyframe: Keyframe, tracked: Tracked, noise: Noise) -> Verdict:
    """Hold a pose against all the spread-out points of the keyframe."""
    coarse = keyframe.coarse
    seen, bright, with_depth, near = choice.verify(
        frame.images[VERIFIED_LEVEL], frame.depth, keyframe.frame.intrinsics[VERIFIED_LEVEL], VERIFIED_LEVEL,
        keyframe.points, keyframe.points.patch[VERIFIED_LEVEL], coarse, tracked.T_frame_kf, tracked.affine, noise,
        VERIFIED_GRAY,
    )  # fmt: skip
    if not (np.isfinite(tracked.T_frame_kf).all() and tracked.points >= 6):
        return Verdict(0.0, 0.0, 0.0)
    if abs(tracked.affine[0]) > GAIN_LIMIT:
        bright = 0
    few = 0 < with_depth < 12  # a frame with little depth is judged by its brightness alone, one with none is broken
    return Verdict(seen / max(len(coarse), 1), bright / max(seen, 1), 1.0 if few else near / max(with_depth, 1))


def recover(
    frame: Frame, keyframe: Keyframe, guesses: list[Array], affine: Array, index: Index, noise: Noise
) -> tuple[Tracked, Verdict]:
    """Try again from each guess of T_frame_kf with all candidates and the widest pyramid, no prior; the best one.

    The finest level keeps the chosen points `index`.
    """
    free = np.diag([1e-2] * 6)
    everyone = np.arange(len(keyframe.points.uv))
    best: tuple[Tracked, Verdict] | None = None
    for guess in guesses:
        tracked = track_frame(frame, keyframe, guess, affine, index, everyone, free, noise, LEVELS)
        verdict = verify(frame, keyframe, tracked, noise)
        if best is None or verdict.score > best[1].score:
            best = (tracked, verdict)
        if not best[1].doubt(WEAK_BELOW):
            break
    assert best is not None  # guesses is never empty
    return best
