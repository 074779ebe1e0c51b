"""What the fused batch makes of images as torch operators: points picked, patches sampled, pyramids."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.library import custom_op

from ..measurement import PIXELS
from . import batch


@custom_op("idrgbdo::pick_points", mutates_args=(), device_types="cpu")
def pick(gray: Tensor, depth: Tensor, cell: int, count: int) -> tuple[Tensor, Tensor]:
    """uv (B, count, 2) and inverse depth (B, count)."""
    return batch.pick(gray, depth, cell, count)


@pick.register_fake
def _(gray: Tensor, depth: Tensor, cell: int, count: int) -> tuple[Tensor, Tensor]:
    B = len(gray)
    return gray.new_empty(B, count, 2, dtype=torch.float64), gray.new_empty(B, count, dtype=torch.float64)


@custom_op("idrgbdo::sample_points", mutates_args=(), device_types="cpu")
def sampled(gray: Tensor, uv: Tensor, levels: int) -> tuple[Tensor, Tensor]:
    """Patches (B, L, N, P) and gradients (B, L, N, P, 2)."""
    return batch.sampled(gray, uv, levels)


@sampled.register_fake
def _(gray: Tensor, uv: Tensor, levels: int) -> tuple[Tensor, Tensor]:
    shape = (len(gray), levels, uv.shape[1], PIXELS)
    return gray.new_empty(shape), gray.new_empty(*shape, 2)


@custom_op("idrgbdo::tracking_pyramid", mutates_args=(), device_types="cpu")
def halved(gray: Tensor, levels: int) -> list[Tensor]:
    """The levels above the image itself."""
    return list(batch.halved(gray, levels)[1:])


@halved.register_fake
def _(gray: Tensor, levels: int) -> list[Tensor]:
    height, width = gray.shape[1:]
    return [gray.new_empty(len(gray), height >> k, width >> k) for k in range(1, levels)]
