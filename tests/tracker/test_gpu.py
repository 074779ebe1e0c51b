"""The kernels of a GPU are the definitions: on a GPU where there is one, else by Triton's interpreter on the CPU."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from plane_world import CAMERA, SLANTED, points, render
from torch import Tensor

from idrgbdo_torch import AlignedPairs, HostPoints, Pinhole, residual_noise
from idrgbdo_torch.definitions import pairs as by_pairs
from idrgbdo_torch.definitions import points as by_points
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.definitions.pairs import PairsTask, aligned_by_definition, pairs_task
from idrgbdo_torch.definitions.tracking import Prior, prior_at
from idrgbdo_torch.tracker import gpu, gpu_images, pairs

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
if DEVICE == "cpu":
    os.environ["TRITON_INTERPRET"] = "1"  # read when a kernel is defined
pytest.importorskip("triton")

EYE = torch.eye(4, dtype=torch.float64)
TRUTH = se3.exp(torch.tensor([[0.02, -0.03, 0.01, 0.01, 0.005, -0.01], [-0.01, 0.01, 0.03, 0.0, 0.01, 0.01]]).double())
# where no point falls between pixels, whose gradient would be that of one or the other by the last bit
START = se3.exp(torch.tensor([3e-3, 2e-3, -1e-3, 1e-3, -2e-3, 1e-3]).double()).expand(2, 4, 4)
STEPS = (3, 4)


def images(seed: int = 0) -> tuple[Tensor, Tensor]:
    """Gray and depth (2, 37, 46) with all that depth may be, on the device."""
    generator = torch.Generator().manual_seed(seed)
    gray = 255 * torch.rand(2, 37, 46, generator=generator)
    depth = 2 + 0.02 * torch.rand(2, 37, 46, generator=generator)
    depth[0, 20:24, 10:14] = 0.0
    depth[1, 5, 5:9] = torch.tensor([float("nan"), float("inf"), -1.0, 1e-3])
    depth[1, 20:, 30:] += 1.0
    return gray.to(DEVICE), depth.to(DEVICE)


def task(
    depth: bool = True, weight: Tensor | None = None, slope: Tensor | None = None, guess: Tensor | Prior = START,
    mode: str = "first_order", none: int = -1,
) -> PairsTask:  # fmt: skip
    """Two images of a plane from TRUTH, with 12 points; `none`: a pair that has none."""
    shots = [render(T, SLANTED) for T in TRUTH]
    uv, d = points(SLANTED, 60)
    uv, d = uv.expand(2, -1, -1), d.repeat(2, 1)
    if none >= 0:
        d[none] = 0.0
    host = by_points.host_points(render(EYE, SLANTED)[0].expand(2, -1, -1), uv, d, weight=weight, levels=len(STEPS))
    gray = torch.stack([image for image, _ in shots]).float()
    metres = torch.stack([1 / inverse for _, inverse in shots]).float()
    noise = replace(residual_noise(), mode=mode)
    out = pairs_task(replace(host, slope=slope), gray, CAMERA, metres if depth else None, guess, noise, STEPS)
    return on(out, DEVICE)


def on(given: PairsTask, device: str) -> PairsTask:
    """The same on another device."""
    p, prior = given.points, given.prior

    def moved(x: Tensor | None) -> Tensor | None:
        return None if x is None else x.to(device)

    def all_of(xs: Sequence[Tensor]) -> tuple[Tensor, ...]:
        return tuple(x.to(device) for x in xs)

    there = HostPoints(
        p.uv.to(device), p.inverse_depth.to(device), p.variance.to(device), all_of(p.patch), all_of(p.gradient),
        moved(p.weight), moved(p.slope),
    )  # fmt: skip
    known = Prior(*all_of([prior.T_target_host, prior.information, prior.affine, prior.affine_information]))
    return replace(given, points=there, gray=given.gray.to(device), depth=moved(given.depth), prior=known)


def same(a: AlignedPairs, b: AlignedPairs) -> None:
    """Everything that align_pairs answers; on a GPU pyramids are a rounding off the definition's."""
    atol = 1e-9 if DEVICE == "cpu" else 1e-7
    for name in ("iterations", "ok", "kept"):
        assert torch.equal(getattr(a, name), getattr(b, name)), name
    torch.testing.assert_close(a.T_target_host, b.T_target_host, rtol=0, atol=atol)
    torch.testing.assert_close(a.affine, b.affine, rtol=0, atol=1e3 * atol)
    torch.testing.assert_close(a.rms, b.rms, rtol=1e3 * atol, atol=1e3 * atol)
    torch.testing.assert_close(a.information, b.information, rtol=1e3 * atol, atol=1e9 * atol)


def test_pyramids_and_inverse_depths_are_those_of_the_definition() -> None:
    gray, depth = images()
    for a, b in zip(by_points.tracking_pyramid(gray, 3), gpu_images.tracking_pyramid(gray, 3), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-4)
    for a, b in zip(pairs.tracking_pyramid(gray.cpu(), 3), gpu_images.tracking_pyramid(gray, 3), strict=True):
        assert torch.equal(a, b.cpu())  # else searches part where they nearly settle
    wanted = by_pairs.inverse_of(depth)
    assert wanted is not None and torch.equal(wanted, gpu_images.inverse_of(depth))


def test_points_and_patches_are_those_of_the_definition() -> None:
    gray, depth = images()
    cell, count = 13, 7
    assert by_points.cell_of((37 - 8) * (46 - 8), count) == cell
    uv, inverse_depth = by_points.pick_points(gray, depth, count)
    picked = gpu_images.pick(gray, depth, cell)
    assert torch.equal(picked[0], uv) and torch.equal(picked[1], inverse_depth)
    uv[0, 0] = -5.0  # clamped
    host = by_points.host_points(gray, uv, inverse_depth, levels=2)
    patches, gradients = gpu_images.sampled(gray, uv, 2)
    for a, b in zip((*host.patch, *host.gradient), (*patches, *gradients), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-4)


@pytest.mark.parametrize("gradient_steps", [0, 2])
def test_the_search_is_the_definition_s(gradient_steps: int) -> None:
    given = task()
    found = gpu.aligned(given, gradient_steps)
    same(found, aligned_by_definition(given, gradient_steps))
    off = se3.log(TRUTH.to(DEVICE) @ se3.inverse(found.T_target_host))
    assert found.ok.all() and off.abs().max() < 2e-3


def test_weights_slopes_and_the_printed_variance_without_depth() -> None:
    weight = torch.linspace(0.5, 2.0, 24).double().reshape(2, 12)
    slope = torch.full((2, 12, 2), 1e-3).double()
    given = task(depth=False, weight=weight, slope=slope, mode="paper")
    same(gpu.aligned(given, 1), aligned_by_definition(given, 1))


def test_what_is_known_beforehand_holds() -> None:
    known = prior_at(TRUTH + 0.0, 1e9 * torch.eye(6).double())
    turned = replace(known, T_target_host=se3.retract(torch.full((2, 6), 0.01).double(), TRUTH))
    given = task(guess=turned)
    found = gpu.aligned(given, 1)
    same(found, aligned_by_definition(given, 1))
    assert (found.T_target_host - turned.T_target_host.to(DEVICE)).abs().max() < 2e-3


def test_a_pair_without_points_is_none_of_the_other_s_business() -> None:
    given = task(none=1)
    found = gpu.aligned(given, 1)
    same(found, aligned_by_definition(given, 1))
    assert found.ok.tolist() == [True, False] and found.T_target_host.isfinite().all()


def test_gradients_are_those_of_the_definition() -> None:
    weight = torch.ones(2, 12).double().requires_grad_()
    given = task(weight=weight)
    (by_kernel,) = torch.autograd.grad(gpu.aligned(given, 1).T_target_host.sum(), weight)
    (wanted,) = torch.autograd.grad(aligned_by_definition(given, 1).T_target_host.sum(), weight)
    assert wanted.abs().max() > 0
    torch.testing.assert_close(by_kernel, wanted, rtol=1e-5, atol=1e-7)


def test_the_public_door_leads_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only from a GPU: on the CPU align_pairs has kernels of its own."""
    given = task()
    assert gpu.has_it(given) == (DEVICE == "cuda")
    monkeypatch.setattr(pairs, "fusable", lambda *_: False)
    monkeypatch.setattr(gpu, "has_it", lambda _: True)
    camera = Pinhole(**{name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")})
    found = pairs.align_pairs(
        given.points, given.gray, camera, depth=given.depth, T_guess=given.prior.T_target_host, steps=STEPS
    )
    same(found, aligned_by_definition(given, 1))
