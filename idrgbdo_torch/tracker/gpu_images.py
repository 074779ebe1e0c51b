"""Whole images of a batch on a GPU: pyramids, inverse depths, picked points, patches, by kernels/gpu/image.py.

For contiguous images (B, H, W) of single precision; gradients are the definitions' business.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from math import ceil
from os import getenv
from shutil import which

import torch
from torch import Tensor

from ..definitions.points import BORDER, ONE_SURFACE
from ..frame import blur_taps
from ..measurement import COARSE_BLUR, PATTERN, PIXELS
from .batch import recorded

# it needs a C compiler to launch anything
TRITON = find_spec("triton") is not None and any(map(which, (getenv("CC", "cc"), "gcc", "clang")))
LINE = 1024  # numbers a program of `inverse` makes
BLOCK = 32  # points a program of `sample` makes
LAST = 2.001  # px from the far border, where patches are clamped to


def can(*images: Tensor) -> bool:
    """Whether the kernels have these images."""
    plain = all(x.is_cuda and x.dtype == torch.float32 and x.ndim == 3 for x in images)
    return TRITON and plain and not recorded(*images)


def on_its_device(x: Tensor) -> AbstractContextManager[object]:
    """Triton launches on the current device, which need not be that of the tensors."""
    return torch.cuda.device(x.device) if x.is_cuda else nullcontext()


def tracking_pyramid(gray: Tensor, levels: int) -> tuple[Tensor, ...]:
    """As tracker.pairs.tracking_pyramid makes it on the CPU, to the bit."""
    from ..kernels.gpu.image import blur, halve

    taps = gray.new_tensor(blur_taps(COARSE_BLUR).tolist())
    finer, images = gray.contiguous(), [gray]
    for _ in range(levels - 1):
        B, height, width = finer.shape
        halved = finer.new_empty(B, height // 2, width // 2)
        columns = power_of_two(width // 2)
        blurred, rows, size = torch.empty_like(halved), B * (height // 2), halved.shape[1:]
        with on_its_device(gray):
            halve[(rows,)](finer, height, width, halved, *size, COLUMNS=columns, enable_fp_fusion=False)
            blur[(rows,)](halved, *size, taps, blurred, COLUMNS=columns, enable_fp_fusion=False)
        images.append(blurred)
        finer = halved
    return tuple(images)


def inverse_of(depth: Tensor) -> Tensor:
    """Twin of definitions.pairs.inverse_of."""
    from ..kernels.gpu.image import inverse

    depth = depth.contiguous()
    out = torch.empty_like(depth)
    with on_its_device(depth):
        inverse[(ceil(depth.numel() / LINE),)](depth, depth.numel(), out, COLUMNS=LINE)
    return out


def pick(gray: Tensor, depth: Tensor, cell: int) -> tuple[Tensor, Tensor]:
    """uv (B, N, 2) and inverse depth (B, N) of square cells, as definitions.points.pick_points."""
    from ..kernels.gpu.image import pick

    B, height, width = gray.shape
    across, down = ceil((width - 2 * BORDER) / cell), ceil((height - 2 * BORDER) / cell)
    uv = gray.new_empty(B, across * down, 2, dtype=torch.float64)
    inverse_depth = gray.new_empty(B, across * down, dtype=torch.float64)
    with on_its_device(gray):
        pick[(B, across * down)](
            (gray.contiguous(), depth.contiguous(), height, width), (cell, across, down),
            gray.new_tensor([ONE_SURFACE]), (uv, inverse_depth), COLUMNS=power_of_two(cell), num_warps=1,
            enable_fp_fusion=False,
        )  # fmt: skip
    return uv, inverse_depth


def sampled(gray: Tensor, uv: Tensor, levels: int) -> tuple[list[Tensor], list[Tensor]]:
    """A level: patches (B, N, P) and gradients (B, N, P, 2), in the precision of uv, as host_points has them."""
    from ..kernels.gpu.image import sample

    B, N = uv.shape[:2]
    places = uv.double().contiguous()
    pattern = torch.tensor(PATTERN.T.ravel(), device=gray.device)
    patches, gradients = [], []
    for level, image in enumerate(tracking_pyramid(gray, levels)):
        patch, gradient = places.new_empty(B, N, PIXELS), places.new_empty(B, N, PIXELS, 2)
        with on_its_device(gray):
            sample[(B, ceil(N / BLOCK))](
                (image.contiguous(), *image.shape[1:]), (places, N), places.new_tensor([0.5**level, LAST]), pattern,
                (patch, gradient), BLOCK=BLOCK, num_warps=1,
            )  # fmt: skip
        patches.append(patch.to(uv.dtype))
        gradients.append(gradient.to(uv.dtype))
    return patches, gradients


def power_of_two(count: int) -> int:
    """The least power of two that is not below count."""
    return 1 << (count - 1).bit_length()
