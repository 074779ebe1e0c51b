"""Gray pyramid, gradients, and bilinear sampling with a validity mask.

Images are (*B, H, W); sampling positions uv (*B, ..., 2) carry the image's batch dimensions first. Outside is invalid,
never clamped: a sample is valid where every pixel that it needs lies in the image, else it is 0 with zero gradients.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import IdRgbdoError

AGREEMENT = 0.05  # relative spread of four neighbouring inverse depths that count as one surface


def pyramid(image: Tensor, levels: int) -> tuple[Tensor, ...]:
    """The image (..., H, W) and its levels - 1 halvings by 2x2 means, finest first; odd last rows and columns drop out.

    Pixel c of a level is pixel 2 c + 0.5 of the finer one, as in Pinhole.at_level.
    """
    images = [image]
    for _ in range(levels - 1):
        finer = images[-1]
        if min(finer.shape[-2:]) < 2:
            raise IdRgbdoError(
                f"levels: expected at most {len(images)} for an image of {tuple(image.shape[-2:])} pixels, got {levels}"
            )
        height, width = (n // 2 * 2 for n in finer.shape[-2:])
        rows = finer[..., 0:height:2, :width] + finer[..., 1:height:2, :width]
        images.append((rows[..., 0::2] + rows[..., 1::2]) / 4)
    return tuple(images)


def gradient(image: Tensor) -> Tensor:
    """Central-difference gradient (..., 2, H, W) in gray levels per px, [right, down]; zero on the border pixels."""
    g = torch.zeros(*image.shape[:-2], 2, *image.shape[-2:], dtype=image.dtype, device=image.device)
    g[..., 0, 1:-1, 1:-1] = (image[..., 1:-1, 2:] - image[..., 1:-1, :-2]) / 2
    g[..., 1, 1:-1, 1:-1] = (image[..., 2:, 1:-1] - image[..., :-2, 1:-1]) / 2
    return g


def sample_bilinear(image: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
    """Bilinear values and validity (*B, ...) of an image (*B, H, W) at uv (*B, ..., 2); valid on 0 <= u <= W - 1."""
    cells, a, b, valid = _cells(image, uv, border=0)
    value = _between(_between(cells, b), a, dim=1)[0, 0]
    return torch.where(valid, value, 0.0), valid


def sample_with_gradient(image: Tensor, uv: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Eq. (9). I(p + dp) = I(p) + g dp: the value I (*B, ...) at uv, its gradient g (*B, ..., 2), and the validity.

    g is the central-difference gradient image sampled bilinearly, which is the same as half the difference of the
    bilinear values one pixel to either side, so it is valid on 1 <= u <= W - 2 (v alike).
    """
    cells, a, b, valid = _cells(image, uv, border=1)
    I = _between(_between(cells, b), a, dim=1)  # (3, 3, *B, ...): bilinear values at v - 1, v, v + 1 by u - 1, u, u + 1
    value = I[1, 1]
    g_u = (I[1, 2] - I[1, 0]) / 2
    g_v = (I[2, 1] - I[0, 1]) / 2
    g = torch.stack([g_u, g_v], dim=-1)
    return torch.where(valid, value, 0.0), torch.where(valid[..., None], g, 0.0), valid


def sample_surface(inverse_depth: Tensor, uv: Tensor, agreement: float = AGREEMENT) -> tuple[Tensor, Tensor, Tensor]:
    """Bilinear inverse depth (*B, ...) at uv, its gradient (*B, ..., 2) in 1/m per px, and validity: one surface only.

    Valid where the four neighbours are positive (0 marks a missing depth) and the largest exceeds the smallest by at
    most the fraction `agreement`. The gradient is the exact derivative of the bilinear value: no further neighbours.
    """
    cells, a, b, valid = _cells(inverse_depth, uv, border=0)
    low, high = cells.amin((0, 1)), cells.amax((0, 1))
    valid = valid & (low > 0) & (high <= (1 + agreement) * low)
    value = _between(_between(cells, b), a, dim=1)[0, 0]
    g_u = _between(cells[:, 1] - cells[:, 0], b)[0]
    g_v = _between(cells[1] - cells[0], a)[0]
    g = torch.stack([g_u, g_v], dim=-1)
    return torch.where(valid, value, 0.0), torch.where(valid[..., None], g, 0.0), valid


def _between(x: Tensor, a: Tensor, dim: int = 0) -> Tensor:
    """Linear interpolation at a (*B, ...) between neighbours along one dimension of x, which shrinks by one."""
    count = x.shape[dim] - 1
    first, second = x.narrow(dim, 0, count), x.narrow(dim, 1, count)
    return first + a * (second - first)


def _cells(image: Tensor, uv: Tensor, border: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The square of n = 2 + 2 border pixels around uv, (n, n, *B, ...) down by right; the place (a, b) of uv; validity.

    (a, b) counts right and down from the middle cell's corner floor(uv), or one before at the far end of the valid
    range. An invalid sample gets some cell of the image.
    """
    batch, (height, width) = image.shape[:-2], image.shape[-2:]
    n = 2 + 2 * border
    if uv.shape[-1:] != (2,) or uv.shape[: len(batch)] != batch:
        raise IdRgbdoError(
            f"uv: expected a shape that starts with the image's batch {tuple(batch)} and ends with 2, "
            f"got {tuple(uv.shape)}; expand it"
        )
    if height < n or width < n:
        raise IdRgbdoError(
            f"image: expected at least {n}x{n} pixels to sample from, got {width}x{height}; use fewer levels"
        )
    u, v = uv.unbind(-1)
    valid = (u >= border) & (u <= width - 1 - border) & (v >= border) & (v <= height - 1 - border)
    u, v = torch.where(valid, u, float(border)), torch.where(valid, v, float(border))
    left = u.detach().floor().clamp(max=width - 2 - border)
    top = v.detach().floor().clamp(max=height - 2 - border)
    corner = (top.long() - border) * width + (left.long() - border)  # (*B, ...)
    step = torch.arange(n, device=image.device)
    steps = (step[:, None] * width + step).reshape(n * n, *[1] * len(batch), 1)
    index = corner.reshape(*batch, -1) + steps  # (n * n, *B, M)
    pixels = image.reshape(*batch, -1).expand(n * n, *batch, -1)
    cells = pixels.gather(-1, index).reshape(n, n, *corner.shape).to(torch.promote_types(image.dtype, uv.dtype))
    return cells, u - left, v - top, valid
