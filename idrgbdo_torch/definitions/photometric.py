"""What one point measures in one frame: warp, residuals, Jacobians and variances, batched (paper, section 3.1).

The paper's j is `host` here, the keyframe that owns the point; its i is `target`, the frame that sees it. A point is a
host pixel uv (..., 2) in px with an inverse depth d (...) in 1/m, compared on a pattern of P pixels around it. Geometry
is that of the centre, the intensity gradient is each pixel's own. Increments xi = [v, w] act on T_target_host from the
left. All floating-point inputs share one dtype, except that images may be float32.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from .. import measurement
from ..errors import IdRgbdoError, door
from .camera import Pinhole, backproject, dP_dinverse_depth, duv_dP, project
from .image import AGREEMENT, sample_surface, sample_with_gradient
from .se3 import hat, transform

PATTERN = torch.from_numpy(measurement.PATTERN)  # (8, 2) px, the residual pattern of DSO, its centre first
WIDE_PATTERN = torch.from_numpy(measurement.PATTERNS[measurement.WIDE])  # for the finest level, with a slope
PATTERN_1 = torch.zeros(1, 2, dtype=torch.float64)  # (1, 2) px, the centre alone


@dataclass(frozen=True)
class Warp:
    """Points of a host as the target sees them."""

    uv: Tensor  # (..., P, 2) px, the pattern's pixels
    valid: Tensor  # (...) bool: inverse depth positive, the whole pattern in front of the target; in the image or not
    centre: Tensor  # (..., 2) px
    P: Tensor  # (..., 3) m, the centre in the target
    dP_dxi: Tensor  # (..., 3, 6)
    dP_dd: Tensor  # (..., 3) m^2
    duv_dxi: Tensor  # (..., 2, 6) of the centre
    duv_dd: Tensor  # (..., 2) of the centre, px m


@dataclass(frozen=True)
class Photometric:
    """Photometric residuals r and their Jacobians; all zero where not valid."""

    r: Tensor  # (..., P) gray levels of the target
    valid: Tensor  # (...) bool: every pixel of the pattern can be compared
    gradient: Tensor  # (..., P, 2) of the target, gray levels per px
    dr_dxi: Tensor  # (..., P, 6)
    dr_dd: Tensor  # (..., P)
    dr_daffine: Tensor  # (..., P, 2)


@dataclass(frozen=True)
class DepthTerm:
    """Inverse-depth residuals r and their Jacobians; all zero where not valid."""

    r: Tensor  # (...) 1/m
    valid: Tensor  # (...) bool
    dr_dxi: Tensor  # (..., 6)
    dr_dd: Tensor  # (...)


@door
def warp(
    camera: Pinhole, uv: Tensor, inverse_depth: Tensor, T_target_host: Tensor, pattern: Tensor = PATTERN,
    slope: Tensor | None = None,
) -> Warp:  # fmt: skip
    """Eq. (3). p_i = Pi(R Pi^-1(p_j, d_j) + t), on the pattern (P, 2) around uv, which lies on one plane.

    uv (..., 2), inverse_depth (...) and T_target_host (..., 4, 4) broadcast. (The paper prints p_i inside Pi^-1.)
    slope (..., 2): how the inverse depth grows along u and v, 1/m per px; None: all pixels have the centre's.
    """
    pixels = uv[..., None, :] + pattern.to(uv)  # (..., P, 2)
    d = inverse_depth[..., None] + (0.0 if slope is None else slope @ pattern.to(uv).mT)  # (..., P)
    P_host = backproject(camera, pixels, d)
    P_target = transform(T_target_host[..., None, :, :], P_host)
    p_target, in_front = project(camera, P_target)

    P_host = backproject(camera, uv, inverse_depth)
    P = transform(T_target_host, P_host)
    centre, centre_in_front = project(camera, P)
    valid = (inverse_depth > 0) & torch.isfinite(inverse_depth) & centre_in_front & in_front.all(-1)

    eye = torch.eye(3, dtype=P.dtype, device=P.device).expand(*P.shape, 3)
    dP_dxi = torch.cat([eye, -hat(P)], dim=-1)
    dP_dd = (T_target_host[..., :3, :3] @ dP_dinverse_depth(camera, uv, inverse_depth)[..., None])[..., 0]
    J = duv_dP(camera, P)
    return Warp(p_target, valid, centre, P, dP_dxi, dP_dd, J @ dP_dxi, (J @ dP_dd[..., None])[..., 0])


def photometric_residual(intensity_target: Tensor, intensity_host: Tensor, affine: Tensor) -> Tensor:
    """Eq. (2). r = I_i(p_i) - e^a I_j(p_j) - b (..., P), in gray levels of the target.

    Intensities are (..., P); affine (..., 2) is the relative brightness [a, b]. It is the paper's difference scaled by
    e^(a_i) and with its sign turned, a = a_i - a_j and b = b_i - e^a b_j: all that one pair of frames can tell.
    """
    a, b = affine[..., :1], affine[..., 1:]
    return intensity_target - a.exp() * intensity_host - b


@door
def linearize(image_target: Tensor, warped: Warp, intensity_host: Tensor, affine: Tensor) -> Photometric:
    """Residuals of `photometric_residual` at warped points with their analytic Jacobians.

    image_target (*B, H, W) gray levels; the points carry *B first. intensity_host (..., P); affine (..., 2).
    """
    intensity, g, inside = sample_with_gradient(image_target, warped.uv)
    g = g.to(warped.uv)
    valid = warped.valid & inside.all(-1)
    r = photometric_residual(intensity, intensity_host, affine)
    dr_dxi = g @ warped.duv_dxi  # (..., P, 6)
    dr_dd = (g @ warped.duv_dd[..., None])[..., 0]  # (..., P)
    gain = (affine[..., :1].exp() * intensity_host).expand_as(r)
    dr_daffine = torch.stack([-gain, -torch.ones_like(gain)], dim=-1)
    one, two = valid[..., None], valid[..., None, None]
    return Photometric(
        torch.where(one, r, 0.0),
        valid,
        torch.where(two, g, 0.0),
        torch.where(two, dr_dxi, 0.0),
        torch.where(one, dr_dd, 0.0),
        torch.where(two, dr_daffine, 0.0),
    )


def projective_distortion(inverse_depth: Tensor, P_target: Tensor, T_target_host: Tensor) -> Tensor:
    """Eq. (6). delta A = |dp_i / dp_j| (...), the signed area of a host pixel's image in the target.

    At fixed inverse depth d the warp is the homography R + d t e_z^T between normalised images, whose Jacobian has the
    determinant det(R + d t e_z^T) / (d z_i)^3, with z_i the depth P_target[..., 2]. It is 1 without motion; 0 or
    less means that the surface is seen edge-on or from behind.
    """
    R, t = T_target_host[..., :3, :3], T_target_host[..., :3, 3]
    homography = 1 + inverse_depth * (R[..., 2] * t).sum(-1)
    return homography / (inverse_depth * P_target[..., 2]) ** 3


def distortion_weight(delta_A: Tensor, c_h: float = 1.0, cap: float = 4.0) -> tuple[Tensor, Tensor]:
    """Eq. (7). h = e^(c_h (delta A - 1)^2) (...) with the exponent at most `cap`, and the mask of delta A > 0."""
    valid = (delta_A > 0) & torch.isfinite(delta_A)
    h = torch.exp((c_h * (torch.where(valid, delta_A, 1.0) - 1) ** 2).clamp(max=cap))
    return h, valid


def photometric_variance(
    gradient: Tensor,
    duv_dd: Tensor,
    sigma_d: float | Tensor,
    *,
    mode: Literal["first_order", "paper"] = "first_order",
    sigma_intensity: float = 4.0,
    sigma_pixel: float = 0.3,
    shared: float = 1.0,
    floor: float | None = None,
) -> Tensor:
    """Eq. (8). sigma_Phi^2 = [(g_u du/dd)^2 + (g_v dv/dd)^2] sigma_d^2 (..., P), gray levels squared, or its safe form.

    gradient (..., P, 2); duv_dd (..., 2) of the centre; sigma_d in 1/m, a number or (...). The printed form (`paper`)
    is zero without parallax, so `floor` is added (sigma_intensity^2 by default; 0 gives the literal print).
    `first_order` propagates exactly and adds the noise of an intensity (gray levels) and of a pixel's position (px):
    sigma_I^2 + shared (sigma_p^2 |g|^2 + (g . duv/dd)^2 sigma_d^2). Errors of position and depth are common to all P
    pixels of a patch: `shared` = P makes the patch count them once.
    """
    slope_u = gradient[..., 0] * duv_dd[..., None, 0]
    slope_v = gradient[..., 1] * duv_dd[..., None, 1]
    variance_d = (sigma_d[..., None] if isinstance(sigma_d, Tensor) else sigma_d) ** 2
    if mode == "paper":
        return (slope_u**2 + slope_v**2) * variance_d + (sigma_intensity**2 if floor is None else floor)
    if mode != "first_order":
        raise IdRgbdoError(f"mode: expected 'first_order' or 'paper', got {mode!r}; choose one of the two")
    position = sigma_pixel**2 * (gradient**2).sum(-1)
    depth = (slope_u + slope_v) ** 2 * variance_d
    return sigma_intensity**2 + shared * (position + depth)


def residual_variance(h: Tensor, sigma2_phi: Tensor) -> Tensor:
    """Eq. (5). sigma_r^2 = h(delta A) sigma_Phi^2 (..., P), from h (...) and sigma_Phi^2 (..., P)."""
    return h[..., None] * sigma2_phi


@door
def depth_residual(
    inverse_depth_target: Tensor, warped: Warp, agreement: float = AGREEMENT, gradient: Tensor | None = None
) -> DepthTerm:
    """Measured minus warped inverse depth at the centre, r = d_target(p_i) - 1 / z_i in 1/m (after DVO and RGBDTAM).

    inverse_depth_target (*B, H, W) in 1/m, 0 where missing; sampled bilinearly where the four neighbours agree within
    the fraction `agreement`, else invalid. gradient (..., 2) in 1/m per px replaces the derivative of the four
    neighbours in the Jacobians: on a Kinect's depth that is mostly noise, so pass a smoother one where there is one.
    """
    measured, g, on_surface = sample_surface(inverse_depth_target, warped.centre, agreement)
    g = (g if gradient is None else gradient).to(warped.centre)
    valid = warped.valid & on_surface
    d = 1 / torch.where(valid, warped.P[..., 2], 1.0)
    r = measured - d
    dr_dxi = (g[..., None, :] @ warped.duv_dxi)[..., 0, :] + (d * d)[..., None] * warped.dP_dxi[..., 2, :]
    dr_dd = (g * warped.duv_dd).sum(-1) + d * d * warped.dP_dd[..., 2]
    return DepthTerm(
        torch.where(valid, r, 0.0),
        valid,
        torch.where(valid[..., None], dr_dxi, 0.0),
        torch.where(valid, dr_dd, 0.0),
    )


def gradient_information(gradient: Tensor, weight: Tensor) -> Tensor:
    """G (..., 2, 2), the sum over the pattern of weight g g^T: gradient (..., P, 2), weight 1 / sigma_r^2 (..., P)."""
    return gradient.mT @ (weight[..., None] * gradient)
