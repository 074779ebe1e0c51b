"""B pairs at once: alone or together the same, converging, differentiable, and good for learning noise and weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial

import pytest
import torch
from plane_world import CAMERA, SLANTED, points, render
from rendered import Film
from torch import Tensor

from idrgbdo_torch.definitions import se3, solver
from idrgbdo_torch.definitions.linearise import (
    ResidualNoise,
    Target,
    gradient_in_target,
    linearise_pairs,
    residual_noise,
)
from idrgbdo_torch.definitions.pairs import AlignedPairs, align_pairs
from idrgbdo_torch.definitions.photometric import warp
from idrgbdo_torch.definitions.points import HostPoints, host_points, pick_points, tracking_pyramid
from idrgbdo_torch.definitions.tracking import STEPS, prior_at
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import prepare

EYE = torch.eye(4, dtype=torch.float64)
LEARNT = 3.0  # gray levels, noise of the keyframes' patches in Planes
PLAIN = replace(residual_noise(), sigma_pixel=0.0, huber=1e3, outlier=1e3, use_depth=False, gradient_blend=0.0)


@dataclass(frozen=True)
class Planes:
    """B images of a plane from known poses; points with exact inverse depths, whose patches are noisy."""

    gray: Tensor  # (B, H, W)
    depth: Tensor  # (B, H, W)
    T: Tensor  # (B, 4, 4) T_target_host
    uv: Tensor  # (B, N, 2)
    inverse_depth: Tensor  # (B, N)

    noise: Tensor  # (B, N, 8) gray levels

    def host(self, inverse_depth: Tensor | None = None, weight: Tensor | None = None) -> HostPoints:
        d = self.inverse_depth if inverse_depth is None else inverse_depth
        clean = host_points(host_image().expand(len(self.T), -1, -1), self.uv, d, sigma=1e-6, weight=weight)
        return replace(clean, patch=(clean.patch[0] + self.noise, *clean.patch[1:]))


@cache
def host_image() -> Tensor:
    return render(EYE, SLANTED)[0]


def planes(count: int, seed: int, noise: float = LEARNT, step: int = 24) -> Planes:
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor([0.05, 0.05, 0.05, 0.02, 0.02, 0.02], dtype=torch.float64)
    T = se3.exp(size * torch.randn(count, 6, generator=generator, dtype=torch.float64))
    shots = [render(pose, SLANTED) for pose in T]
    gray, depth = torch.stack([g for g, _ in shots]), torch.stack([1 / d for _, d in shots])
    uv, d = points(SLANTED, step)
    fuzz = noise * torch.randn(count, len(d), 8, generator=generator, dtype=torch.float64)
    return Planes(gray, depth, T, uv.expand(count, -1, -1), d.expand(count, -1), fuzz)


def off(aligned: AlignedPairs, T: Tensor) -> Tensor:
    """(B, 6) left increments from the estimates to the truth."""
    return se3.log(T @ se3.inverse(aligned.T_target_host))


def test_pairs_do_not_know_of_each_other() -> None:
    world = planes(3, seed=0)
    together = align_pairs(world.host(), world.gray, CAMERA, depth=world.depth)
    assert together.ok.all() and len(set(together.iterations.tolist())) > 1  # each pair rests when it has settled
    for b in range(3):
        one = Planes(*(x[b : b + 1] for x in vars(world).values()))
        alone = align_pairs(one.host(), one.gray, CAMERA, depth=one.depth)
        torch.testing.assert_close(alone.T_target_host[0], together.T_target_host[b], rtol=0, atol=1e-12)
        torch.testing.assert_close(alone.information[0], together.information[b], rtol=1e-9, atol=1e-3)
        assert alone.iterations[0] == together.iterations[b]


@pytest.mark.parametrize("gradient_steps", [0, 1])
def test_all_steps_with_masks_end_where_early_stopping_does(
    gradient_steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a GPU does, which is never asked whether all have settled, is what the CPU does, to the last bit."""
    world = planes(3, seed=0)
    weight = torch.ones(world.inverse_depth.shape, requires_grad=gradient_steps > 0)
    asks = partial(align_pairs, world.host(weight=weight), world.gray, CAMERA, depth=world.depth)
    early = asks(gradient_steps=gradient_steps)
    assert int(early.iterations.max()) < sum(STEPS)
    monkeypatch.setattr(solver, "ASKED", frozenset())
    masked = asks(gradient_steps=gradient_steps)
    for name in ("T_target_host", "affine", "information", "rms", "iterations", "ok"):
        assert torch.equal(getattr(early, name), getattr(masked, name)), name


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_finds_the_same() -> None:
    world = planes(3, seed=0)
    host = world.host()
    there = HostPoints(
        host.uv.cuda(), host.inverse_depth.cuda(), host.variance.cuda(), tuple(x.cuda() for x in host.patch),
        tuple(x.cuda() for x in host.gradient),
    )  # fmt: skip
    here = align_pairs(host, world.gray, CAMERA, depth=world.depth)
    aligned = align_pairs(there, world.gray.cuda(), CAMERA, depth=world.depth.cuda())
    assert aligned.T_target_host.is_cuda
    torch.testing.assert_close(aligned.T_target_host.cpu(), here.T_target_host, rtol=0, atol=1e-5)
    torch.testing.assert_close(aligned.information.cpu(), here.information, rtol=1e-5, atol=1.0)


def test_padding_is_no_point() -> None:
    world = planes(2, seed=1)
    keep = torch.arange(world.uv.shape[1]) % 3 > 0
    padded = align_pairs(world.host(torch.where(keep, world.inverse_depth, 0.0)), world.gray, CAMERA)
    fewer = Planes(
        world.gray, world.depth, world.T, *(x[:, keep] for x in (world.uv, world.inverse_depth, world.noise))
    )
    compact = align_pairs(fewer.host(), fewer.gray, CAMERA)
    torch.testing.assert_close(padded.T_target_host, compact.T_target_host, rtol=0, atol=1e-12)
    assert (padded.rms[:, ~keep] == -1).all() and not padded.kept[:, ~keep].any()


@pytest.mark.parametrize("use_depth", [True, False])
def test_the_motion_is_found(use_depth: bool) -> None:
    world = planes(6, seed=2, noise=0.0)
    noise = replace(residual_noise(), use_depth=use_depth)
    aligned = align_pairs(world.host(), world.gray, CAMERA, depth=world.depth, noise=noise)
    error = off(aligned, world.T)
    assert aligned.ok.all() and error[:, :3].norm(dim=1).max() < 1e-3 and error[:, 3:].norm(dim=1).max() < 5e-4
    assert aligned.affine.abs().max() < 0.5


def test_errors_have_the_size_that_the_information_says() -> None:
    world = planes(40, seed=3, step=30)
    noise = replace(PLAIN, sigma_intensity=LEARNT)
    aligned = align_pairs(world.host(), world.gray, CAMERA, T_guess=world.T, noise=noise, steps=(8,))
    error = off(aligned, world.T)
    chi2 = (error[:, None] @ aligned.information @ error[..., None]).mean() / 6
    assert 0.75 < chi2 < 1.3


def test_a_broken_image_spoils_its_own_pair_only() -> None:
    world = planes(2, seed=4)
    gray = world.gray.clone()
    gray[1] = torch.nan
    aligned = align_pairs(world.host(), gray, CAMERA)
    assert aligned.ok.tolist() == [True, False]
    clean = align_pairs(world.host(), world.gray, CAMERA)
    torch.testing.assert_close(aligned.T_target_host[0], clean.T_target_host[0], rtol=0, atol=1e-12)


def test_the_pyramid_is_the_tracker_s(desk: Film) -> None:
    frame = prepare(desk.frames[3])
    for mine, image in zip(tracking_pyramid(desk.frames[3].gray[None], 5), frame.images[:5], strict=True):
        torch.testing.assert_close(mine[0], torch.from_numpy(image), rtol=0, atol=1e-3)


def test_a_keyframe_s_gradient_as_the_target_shows_it() -> None:
    """Against the chain rule: the gradient of the host's brightness along the inverse warp."""
    T = planes(1, seed=5).T[0]
    uv, d = points(SLANTED, 60)
    warped = warp(CAMERA, uv, d, T)
    g = torch.randn(len(uv), 8, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    moved = gradient_in_target(CAMERA, g, d, warped, T)
    for n in range(len(uv)):
        dp = torch.func.jacfwd(lambda p, n=n: warp(CAMERA, p, d[n], T).centre)(uv[n])
        torch.testing.assert_close(moved[n] @ dp, g[n], rtol=1e-10, atol=1e-10)


def test_points_are_picked_amid_one_surface_on_the_strongest_gradient(desk: Film) -> None:
    gray = torch.stack([desk.frames[k].gray for k in (0, 20)])
    depth = torch.stack([desk.frames[k].depth for k in (0, 20)])
    depth[1, :, :100] = 0.0
    uv, d = pick_points(gray, depth, 300)
    assert 200 < uv.shape[1] < 400 and uv.shape == (*d.shape, 2)
    assert (d[0] > 0).float().mean() > 0.6
    on = d > 0
    u, v = uv.long().unbind(-1)
    at = depth[torch.arange(2)[:, None], v, u].double()
    torch.testing.assert_close(d[on], 1 / at[on])
    assert (u[1][on[1]] >= 102).all()
    slope = torch.stack(torch.gradient(gray, dim=(1, 2))).norm(dim=0)
    assert slope[torch.arange(2)[:, None], v, u][on].median() > 2 * slope.median()
    with pytest.raises(IdRgbdoError, match="pick_points"):
        pick_points(gray[0], depth[0], 10)


NOISES = {
    # so much noise that the robust scale rests at its least, which it keeps when the weights change
    "plain": replace(PLAIN, sigma_intensity=10.0),
    "robust": replace(residual_noise(), sigma_intensity=10.0, use_depth=False, gradient_blend=0.0),
    "as the tracker has it": replace(residual_noise(), sigma_intensity=10.0),
}


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_gradients_are_those_of_the_minimum(noise: ResidualNoise) -> None:
    """d pose / d weights by autograd against differences of the converged pose."""
    world = planes(2, seed=6, noise=2.0, step=30)
    direction = torch.randn(world.inverse_depth.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def pose(size: float | Tensor, gradient_steps: int) -> Tensor:
        aligned = align_pairs(
            world.host(weight=(size * direction).exp()), world.gray, CAMERA, depth=world.depth, T_guess=world.T,
            noise=noise, steps=(8,), gradient_steps=gradient_steps,
        )  # fmt: skip
        return se3.log(aligned.T_target_host @ se3.inverse(world.T))

    h = 1e-4
    expected = (pose(h, 30) - pose(-h, 30)) / (2 * h)
    assert not pose(torch.zeros((), requires_grad=True), 0).requires_grad
    size = torch.zeros((), dtype=torch.float64, requires_grad=True)
    here = pose(size, 1)
    got = [torch.autograd.grad(here[b, k], size, retain_graph=True)[0] for b in range(2) for k in range(6)]
    assert (torch.stack(got).reshape(2, 6) - expected).norm() < 1e-6 * expected.norm()


def test_everything_can_carry_a_gradient() -> None:
    """Residuals and Jacobians: H and b against finite differences of every input."""
    world = planes(1, seed=7, step=40)
    host = world.host()
    inputs = {
        "inverse_depth": host.inverse_depth, "patch": host.patch[0], "gray": world.gray, "T": world.T,
        "sigma": torch.tensor(4.0).double(), "sigma_pixel": torch.tensor(0.3).double(),
    }  # fmt: skip
    noise = replace(residual_noise(), use_depth=False, gradient_blend=0.3)

    def total(x: dict[str, Tensor]) -> Tensor:
        points = replace(host, inverse_depth=x["inverse_depth"], patch=(x["patch"],))
        model = replace(noise, sigma_intensity=x["sigma"], sigma_pixel=x["sigma_pixel"])
        system = linearise_pairs(points, Target(0, x["gray"], CAMERA), x["T"], torch.zeros(1, 2), model)
        unit = torch.tensor([1e-2] * 6 + [1e-1, 1.0]).double()
        return (unit * system.H[0] * unit[:, None]).sum() + (unit * system.b[0]).sum()

    generator = torch.Generator().manual_seed(2)
    for name, value in inputs.items():
        direction = torch.randn(value.shape, generator=generator, dtype=torch.float64) * (1e-3 if name == "T" else 1.0)
        moved = lambda t, name=name, value=value, direction=direction: total({**inputs, name: value + t * direction})
        t = torch.zeros((), dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(moved(t), t)
        h = 1e-6
        with torch.no_grad():
            expected = (moved(torch.tensor(h)) - moved(torch.tensor(-h))) / (2 * h)
        assert float(slope) == pytest.approx(float(expected), rel=1e-4), name
        assert abs(float(slope)) > 0


def test_the_noise_scale_is_learnt_from_known_motion() -> None:
    """Gradient descent on the likelihood of the pose errors finds the gray levels of noise that were put in."""
    world = planes(30, seed=8, step=30)
    log_sigma = torch.tensor(2.5, dtype=torch.float64, requires_grad=True)  # 12 gray levels
    optimiser = torch.optim.Adam([log_sigma], lr=0.25)
    host = world.host()
    for _ in range(20):
        noise = replace(PLAIN, sigma_intensity=log_sigma.exp())
        aligned = align_pairs(host, world.gray, CAMERA, T_guess=world.T, noise=noise, steps=(3,))
        error = off(aligned, world.T)
        surprise = 0.5 * (error[:, None] @ aligned.information @ error[..., None]).mean()
        loss = surprise - 0.5 * torch.logdet(aligned.information).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert float(log_sigma.detach().exp()) == pytest.approx(LEARNT, rel=0.12)


def test_learnt_weights_lower_the_error_of_other_pairs() -> None:
    """Depth is 15 % wrong in a third of the image; a weight for those points is learnt and helps on held-out pairs."""

    def bent(world: Planes) -> tuple[Tensor, Tensor]:
        odd = world.uv[..., 0] > 2 / 3 * CAMERA.width
        return torch.where(odd, 1.15 * world.inverse_depth, world.inverse_depth), odd

    def loss(world: Planes, trust: Tensor) -> Tensor:
        d, odd = bent(world)
        host = world.host(d, torch.where(odd, trust.exp(), 1.0))
        aligned = align_pairs(host, world.gray, CAMERA, T_guess=world.T, noise=PLAIN, steps=(3,))
        return off(aligned, world.T).square().sum(-1).mean().sqrt()

    training, held_out = planes(10, seed=9, noise=1.0), planes(10, seed=10, noise=1.0)
    trust = torch.zeros((), dtype=torch.float64, requires_grad=True)
    before = float(loss(held_out, trust.detach()))
    optimiser = torch.optim.Adam([trust], lr=0.5)
    for _ in range(12):
        optimiser.zero_grad()
        loss(training, trust).backward()
        optimiser.step()
    after = float(loss(held_out, trust.detach()))
    assert float(trust.detach()) < -2 and after < 0.5 * before, (before, after)


def test_a_prior_holds_the_guess_and_starts_from_its_brightness() -> None:
    world = planes(2, seed=13, noise=0.0)
    guess = se3.retract(torch.full((6,), 0.004, dtype=torch.float64), world.T)
    certain = 1e14 * torch.eye(6, dtype=torch.float64)
    held = align_pairs(world.host(), world.gray, CAMERA, T_guess=prior_at(guess, certain))
    torch.testing.assert_close(held.T_target_host, guess, rtol=0, atol=1e-6)
    free = align_pairs(world.host(), world.gray, CAMERA, T_guess=guess)
    assert off(free, world.T).norm(dim=1).max() < 1e-3
    assert torch.equal(align_pairs(world.host(), world.gray, CAMERA, T_guess=prior_at(guess)).affine, free.affine)
    brighter = torch.tensor([[0.8, 60.0]] * 2).double()
    gray = brighter[0, 0].exp() * world.gray + brighter[0, 1]
    known = align_pairs(world.host(), gray, CAMERA, T_guess=prior_at(guess, affine=brighter))
    assert off(known, world.T).norm(dim=1).max() < 2e-3 and (known.affine - brighter).abs().max() < 0.5
    start = align_pairs(
        world.host(), gray, CAMERA, T_guess=prior_at(guess, affine=brighter), steps=(0,), gradient_steps=0
    )
    assert torch.equal(start.T_target_host, guess) and torch.equal(start.affine, brighter)


def test_wrong_shapes_are_named() -> None:
    world = planes(2, seed=11)
    with pytest.raises(IdRgbdoError, match=r"host_points: expected gray \(B, H, W\)"):
        host_points(host_image(), world.uv, world.inverse_depth)
    with pytest.raises(IdRgbdoError, match="as many images as pairs"):
        align_pairs(world.host(), world.gray[:1], CAMERA)
    with pytest.raises(IdRgbdoError, match="levels"):
        align_pairs(replace(world.host(), patch=()), world.gray, CAMERA)


@pytest.mark.parametrize("use_depth", [True, False])
def test_single_precision_measures_the_same(use_depth: bool) -> None:
    world = planes(3, seed=12)
    noise = replace(residual_noise(), use_depth=use_depth, huber=1e3)  # no kinks that rounding decides at
    inverse_depth = 1 / world.depth
    systems = []
    for dtype in (torch.float64, torch.float32):
        host = world.host()
        host = HostPoints(
            host.uv.to(dtype), host.inverse_depth.to(dtype), host.variance.to(dtype),
            tuple(x.to(dtype) for x in host.patch), tuple(x.to(dtype) for x in host.gradient),
        )  # fmt: skip
        target = Target(0, world.gray.to(dtype), CAMERA, inverse_depth.to(dtype))
        systems.append(linearise_pairs(host, target, world.T, torch.zeros(3, 2, dtype=dtype), noise))
    double, single = systems
    unit = double.H.diagonal(dim1=1, dim2=2).rsqrt()
    H, H32 = (unit[:, :, None] * system.H * unit[:, None] for system in systems)
    torch.testing.assert_close(H32, H, rtol=0, atol=1e-5)
    # residuals of thousands of gray levels cancel in b, so it is held against what it could be at most, if none did:
    # J^T W r <= sqrt(J^T W J) sqrt(r^T W r)
    size = float(double.energy.sqrt().max())
    torch.testing.assert_close(unit * single.b, unit * double.b, rtol=0, atol=1e-5 * size)
    torch.testing.assert_close(single.energy, double.energy, rtol=1e-5, atol=0)
    assert torch.equal(single.kept, double.kept)
