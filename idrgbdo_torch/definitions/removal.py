"""Which keyframe a window can spare: what each still has to tell about the view to come (instead of Eq. 26)."""

from __future__ import annotations

from math import log

import torch
from torch import Tensor

from ..measurement import LINK_FLOOR, UNKNOWN


def next_view_bits(information: Tensor, links: Tensor, adjoints: Tensor) -> Tensor:
    """What the pose of the next view would lose (K,), in bits, if it could not be measured against each keyframe.

    Marginalisation keeps what a keyframe has said (Eqs. 21 to 25). What goes with it is what it would still say: the
    measurements that the next view would make of it. The view is taken to be where the newest keyframe is.
    information: (6K, 6K) of all keyframe poses. links: (K, 6, 6) information of the measurement of the view's pose
    against each keyframe, by a left increment of the view. adjoints: (K, 6, 6) of T_view_keyframe.

    Each keyframe places the view with its own error (adjoint times its increment) and the link's; keyframes that share
    errors, or are uncertain in the world, add less. With W the inverse of the joint covariance of these K placings
    (6K, 6K) and w_k the sum of its rows' blocks k, the view's information is the sum of all w_k; without keyframe k it
    is smaller by w_k W_kk^-1 w_k^T, and the entropy (Eq. 11) larger by half the logarithm of the ratio.
    """
    K = len(links)
    scale = information.diagonal().clamp(min=1e-12).rsqrt()
    unit = scale[:, None] * information * scale
    unknown = UNKNOWN * torch.eye(6 * K, dtype=unit.dtype, device=unit.device)
    covariance = scale[:, None] * torch.linalg.inv(unit + unknown) * scale
    moved = _blocks(adjoints)
    floor = LINK_FLOOR * links.diagonal(dim1=1, dim2=2).amax(0)
    placings = moved @ covariance @ moved.mT + _blocks(torch.linalg.inv(links + torch.diag(floor)))
    unit = placings.diagonal().rsqrt()
    W = (unit[:, None] * torch.linalg.inv(unit[:, None] * placings * unit) * unit).reshape(K, 6, K, 6)
    w = W.sum(0).permute(1, 0, 2)  # (K, 6, 6), rows of the view
    own = W.diagonal(dim1=0, dim2=2).permute(2, 0, 1)  # (K, 6, 6)
    lost = w @ torch.linalg.solve(own, w.mT)
    share = torch.linalg.solve(w.sum(0).expand(K, 6, 6), lost)
    eye = torch.eye(6, dtype=share.dtype, device=share.device)
    bits: Tensor = -0.5 * torch.linalg.slogdet(eye - share).logabsdet / log(2.0)
    return bits


def _blocks(blocks: Tensor) -> Tensor:
    """(6K, 6K) with the blocks (K, 6, 6) on its diagonal."""
    K = len(blocks)
    out = blocks.new_zeros(K, 6, K, 6)
    k = torch.arange(K, device=blocks.device)
    out[k, :, k] = blocks
    return out.reshape(6 * K, 6 * K)
