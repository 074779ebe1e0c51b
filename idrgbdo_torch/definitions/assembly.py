"""The window's normal equations from those of its pairs, and their Schur complement: twin of kernels.assembly."""

from __future__ import annotations

import torch
from torch import Tensor

from ..measurement import STEP, WindowPairs, WindowPoints, WindowState, WindowSystem
from .convert import Array
from .se3 import inverse, log
from .window import relative_poses


def distances(pairs: WindowPairs, state: WindowState) -> Array:
    """Twin of kernels.assembly.distances."""
    squared, *_ = _shifted(pairs, state)
    K, N = state.inv_depth.shape
    far = torch.where(torch.eye(K, dtype=torch.bool), 0.0, torch.inf)
    return torch.where(torch.from_numpy(pairs.taken), squared / (STEP + N), far).numpy()


def assemble(pairs: WindowPairs, state: WindowState, points: WindowPoints, which: Array, system: WindowSystem) -> float:
    """Twin of kernels.assembly.assemble: fills the system, returns the energy."""
    part = which & pairs.taken
    squared, along, b, bd = (_of(part, x) for x in _shifted(pairs, state))
    H, _, chain, Hd, _, cross, _, energy, *_ = (_of(part, torch.from_numpy(x)) for x in pairs)
    takes_part = torch.from_numpy(points.valid & which.diagonal()[:, None])
    own = torch.where(takes_part, torch.from_numpy(state.inv_depth - points.measured), 0.0)
    weight = torch.where(takes_part, 1 / torch.from_numpy(points.variance), 0.0)
    system.Hd[:] = (Hd.sum(1) + weight).numpy()
    system.bd[:] = (bd.sum(1) - weight * own).numpy()
    _fill(system, H, b, chain, cross)
    return float((energy + squared - 2 * along).sum() + (weight * own.square()).sum())


def _of(part: Array, x: Tensor) -> Tensor:
    """Of some pairs (K, K) what x (K, K, ...) has, zeros of the others."""
    return torch.where(torch.from_numpy(part).view(*part.shape, *[1] * (x.ndim - 2)), x, 0.0)


def _shifted(pairs: WindowPairs, state: WindowState) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The increment of each pair in squared standard deviations (K, K) and along the right sides, and those after it:
    b (K, K, 8), bd (K, K, N)."""
    H, b, chain, Hd, bd, cross, _, _, taken, at_T, at_affine, at_inv_depth = (torch.from_numpy(x) for x in pairs)
    T = relative_poses(torch.from_numpy(state.T))[:, :, 0].transpose(0, 1)
    pose = log(T @ inverse(torch.where(taken[..., None, None], at_T, T)))
    affine = torch.from_numpy(state.affine)
    gains = chain.diagonal(dim1=-2, dim2=-1)[..., 6:]
    brightness = affine - at_affine[:, :, 1] + gains * (affine[:, None] - at_affine[:, :, 0])
    away = torch.where(taken[..., None], torch.cat([pose, brightness], dim=-1), 0.0)
    depth = torch.where(taken[..., None], torch.from_numpy(state.inv_depth)[:, None] - at_inv_depth, 0.0)
    H_away, with_pose = (H @ away[..., None])[..., 0], (cross.mT @ away[..., None])[..., 0]
    with_depth = (cross @ depth[..., None])[..., 0]
    squared = (away * H_away).sum(-1) + (depth * (Hd * depth + 2 * with_pose)).sum(-1)
    along = (away * b).sum(-1) + (depth * bd).sum(-1)
    return squared, along, b - H_away - with_depth, bd - Hd * depth - with_pose


def eliminate_depths(system: WindowSystem) -> tuple[Array, Array]:
    """Twin of kernels.assembly.eliminate_depths: the Schur complement of the diagonal block of inverse depths."""
    known = torch.from_numpy(system.Hd).flatten()
    rows = torch.from_numpy(system.cross).mT.flatten(0, 1)  # (K N, 8 K)
    share = torch.where((known > 0)[:, None], rows / torch.where(known > 0, known, 1.0)[:, None], 0.0)
    out = torch.from_numpy(system.H) - share.mT @ rows
    rhs = torch.from_numpy(system.b) - share.mT @ torch.from_numpy(system.bd).flatten()
    return (0.5 * (out + out.mT)).numpy(), rhs.numpy()


def _fill(system: WindowSystem, H: Tensor, b: Tensor, chain: Tensor, cross: Tensor) -> None:
    """Sum the equations of pairs (host, target, ...) into those of the keyframes."""
    K, N = len(cross), cross.shape[-1]
    across = H @ chain  # of the target by the host
    blocks = across.permute(1, 2, 0, 3) + across.permute(0, 3, 1, 2)  # (K, 8, K, 8), both triangles
    k = torch.arange(K)
    blocks[k, :, k] += H.sum(0) + (chain.mT @ across).sum(1)
    system.H[:] = blocks.reshape(STEP * K, STEP * K).numpy()
    system.b[:] = (b.sum(0) + (chain.mT @ b[..., None])[..., 0].sum(1)).flatten().numpy()
    full = cross.clone()  # (host, target, 8, N)
    full[k, k] += (chain.mT @ cross).sum(1)
    system.cross[:] = full.reshape(K, STEP * K, N).numpy()
