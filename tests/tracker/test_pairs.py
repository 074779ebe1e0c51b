"""The public batch: the definition's numbers and gradients, one pose alone and together, whole for torch.compile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from rendered import Film
from torch import Tensor

from idrgbdo_torch import (
    AlignedPairs,
    HostPoints,
    IdRgbdoError,
    ResidualNoise,
    Target,
    align_pairs,
    host_points,
    linearise_pairs,
    pick_points,
    residual_noise,
    tracking_pyramid,
)
from idrgbdo_torch.definitions import linearise, pairs, points
from idrgbdo_torch.definitions.photometric import WIDE_PATTERN
from idrgbdo_torch.definitions.se3 import inverse, log, retract
from idrgbdo_torch.definitions.tracking import prior_at
from idrgbdo_torch.tracker import operators

HOSTS, TARGETS = (0, 8, 16, 24, 30), (2, 10, 18, 27, 33)
Leaves = dict[str, Tensor]


class Pairs:
    """Some pairs of the desk, with points."""

    def __init__(self, desk: Film) -> None:
        frames = desk.frames
        self.camera = frames[0].camera
        self.host = torch.stack([frames[k].gray for k in HOSTS])
        self.host_depth = torch.stack([frames[k].depth for k in HOSTS])
        self.gray = torch.stack([frames[k].gray for k in TARGETS])
        self.depth = torch.stack([frames[k].depth for k in TARGETS])
        self.T = torch.stack([desk.T(b, a) for a, b in zip(HOSTS, TARGETS, strict=True)])
        self.uv, self.inverse_depth = pick_points(self.host, self.host_depth, 120)
        self.points = host_points(self.host, self.uv, self.inverse_depth)


@pytest.fixture(scope="module")
def some(desk: Film) -> Pairs:
    return Pairs(desk)


def off(aligned: AlignedPairs, T: Tensor) -> Tensor:
    """(B, 6) of poses from others."""
    return log(T @ inverse(aligned.T_target_host))


def test_points_are_those_of_the_definition(some: Pairs) -> None:
    holes = some.host_depth.clone()
    holes[0, 50:90, 60:200] = 0.0
    holes[1, ::7] = torch.nan
    for depth in (some.host_depth, holes):
        uv, inverse_depth = pick_points(some.host, depth, 120)
        expected_uv, expected = points.pick_points(some.host, depth, 120)
        assert torch.equal(uv, expected_uv) and torch.equal(inverse_depth, expected)
        assert 0.3 < (inverse_depth > 0).float().mean() < 1
    theirs = points.host_points(some.host, some.uv, some.inverse_depth)
    for name in ("patch", "gradient"):
        for mine, level in zip(getattr(some.points, name), getattr(theirs, name), strict=True):
            torch.testing.assert_close(mine.double(), level.double(), rtol=0, atol=1e-3)
    assert torch.equal(some.points.variance, theirs.variance)
    for mine, level in zip(tracking_pyramid(some.host, 5), points.tracking_pyramid(some.host, 5), strict=True):
        torch.testing.assert_close(mine, level, rtol=0, atol=1e-3)


def test_a_batch_is_the_definition_s(some: Pairs) -> None:
    """From the search to where nothing moves; the truth is near, and the coarse levels start far from it."""
    mine = align_pairs(some.points, some.gray, some.camera, depth=some.depth)
    theirs = pairs.align_pairs(some.points, some.gray, some.camera, depth=some.depth)
    spread = torch.linalg.inv(theirs.information).diagonal(dim1=1, dim2=2).sqrt()
    assert ((off(mine, theirs.T_target_host) / spread).abs() < 0.3).all()  # both stopped short of the minimum
    assert torch.equal(mine.ok, theirs.ok) and mine.ok.all() and off(mine, some.T)[:, :3].norm(dim=1).max() < 0.02
    random = torch.rand(*some.uv.shape[:2], 8, generator=torch.Generator().manual_seed(0))
    for weight in (None, random[..., 0] + 0.5, random + 0.5):
        host = replace(some.points, weight=weight, slope=1e-4 * random[..., :2].double())
        start = {"depth": some.depth, "T_guess": some.T, "steps": (8,), "gradient_steps": 40}
        mine, theirs = (f(host, some.gray, some.camera, **start) for f in (align_pairs, pairs.align_pairs))
        assert off(mine, theirs.T_target_host).abs().max() < 1e-8
        assert (mine.affine - theirs.affine).abs().max() < 1e-6 and torch.equal(mine.kept, theirs.kept)
        unit = theirs.information.diagonal(dim1=1, dim2=2).rsqrt()
        information, expected = (unit[:, :, None] * x.information * unit[:, None] for x in (mine, theirs))
        torch.testing.assert_close(information, expected, rtol=0, atol=1e-6)
        torch.testing.assert_close(mine.rms, theirs.rms, rtol=0, atol=1e-6)


def test_wide_patches_are_wide_in_either_way(some: Pairs) -> None:
    wide = replace(residual_noise(), wide=True)
    patch, gradient = points.sample_patterns([some.host], some.uv, WIDE_PATTERN)
    slope = torch.full((*some.uv.shape[:2], 2), 1e-4, dtype=torch.float64)
    host = replace(some.points, patch=tuple(patch), gradient=tuple(gradient), slope=slope)
    start = {"depth": some.depth, "T_guess": some.T, "steps": (8,), "gradient_steps": 40, "noise": wide}
    mine, theirs = (f(host, some.gray, some.camera, **start) for f in (align_pairs, pairs.align_pairs))
    assert off(mine, theirs.T_target_host).abs().max() < 1e-8
    narrow = align_pairs(host, some.gray, some.camera, **{**start, "noise": residual_noise()})
    assert off(narrow, mine.T_target_host).abs().max() > 1e-5


def test_a_pose_is_the_same_alone_and_on_any_number_of_threads(some: Pairs) -> None:
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            results.append(align_pairs(some.points, some.gray, some.camera, depth=some.depth))
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert torch.equal(other.T_target_host, results[0].T_target_host)
    for b in range(len(HOSTS)):
        one = some.points
        cut = slice(b, b + 1)
        alone = HostPoints(
            one.uv[cut], one.inverse_depth[cut], one.variance[cut], tuple(x[cut] for x in one.patch),
            tuple(x[cut] for x in one.gradient),
        )  # fmt: skip
        aligned = align_pairs(alone, some.gray[cut], some.camera, depth=some.depth[cut])
        assert torch.equal(aligned.T_target_host[0], results[0].T_target_host[b])
        assert torch.equal(aligned.rms[0], results[0].rms[b])


def leaves_of(some: Pairs) -> Leaves:
    """Whatever may be learnt."""
    values = {
        "weight": torch.linspace(0.5, 2.0, some.uv[..., 0].numel()).reshape(some.uv.shape[:2]).double(),
        "inverse_depth": some.inverse_depth, "gray": some.gray, "depth": some.depth,
        "sigma": torch.tensor(4.0).double(), "T": some.T, "patch": some.points.patch[0],
    }  # fmt: skip
    return {name: value.clone().requires_grad_() for name, value in values.items()}


def asked(f: Callable[..., AlignedPairs], some: Pairs, x: Leaves, noise: ResidualNoise, steps: int) -> AlignedPairs:
    host = replace(some.points, weight=x["weight"], inverse_depth=x["inverse_depth"])
    host = replace(host, patch=(x["patch"], *some.points.patch[1:]))
    prior = prior_at(x["T"], 1e4 * torch.eye(6))
    model = replace(noise, sigma_intensity=x["sigma"])
    return f(
        host, x["gray"], some.camera, depth=x["depth"], T_guess=prior, noise=model, steps=(8,), gradient_steps=steps
    )


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("use_depth", [True, False])
def test_gradients_are_the_definition_s(some: Pairs, steps: int, use_depth: bool) -> None:
    noise = replace(residual_noise(), use_depth=use_depth)
    found: list[Leaves] = []
    for f in (align_pairs, pairs.align_pairs):
        x = leaves_of(some)
        aligned = asked(f, some, x, noise, steps)
        cost = (off(aligned, some.T) * torch.arange(1.0, 7.0)).sum() + 1e-3 * aligned.affine.sum()
        cost = cost + torch.logdet(aligned.information).sum() * 1e-2
        grads = torch.autograd.grad(cost, list(x.values()), allow_unused=True)
        found.append({n: torch.zeros_like(x[n]) if g is None else g for n, g in zip(x, grads, strict=True)})
        assert not aligned.rms.requires_grad
    mine, theirs = found
    for name, expected in theirs.items():
        if name != "depth" or use_depth:
            assert float(expected.norm()) > 0, name
        assert (mine[name] - expected).norm() <= 1e-6 * expected.norm(), name


@pytest.mark.parametrize("level", [0, 2])
def test_normal_equations_and_their_gradients_are_the_definition_s(some: Pairs, level: int) -> None:
    image, there = tracking_pyramid(some.gray, 3)[level], pairs.inverse_of(some.depth)
    scale = torch.linspace(0.7, 1.3, len(some.T)).double()
    found = []
    for f in (linearise_pairs, linearise.linearise_pairs):
        sigma, T = torch.tensor(5.0, dtype=torch.float64, requires_grad=True), some.T.clone().requires_grad_()
        noise = replace(residual_noise(), sigma_intensity=sigma)
        target = Target(level, image, some.camera, there)
        system = f(some.points, target, T, torch.full((len(T), 2), 0.05).double(), noise, scale, 3.0)
        grads = torch.autograd.grad(system.b.sum() + system.H.sum() * 1e-3 + system.energy.sum(), [sigma, T])
        found.append((system, grads))
    (mine, my_grads), (theirs, their_grads) = found
    unit = theirs.H.detach().diagonal(dim1=1, dim2=2).rsqrt()
    H, expected = (unit[:, :, None] * x.H * unit[:, None] for x in (mine, theirs))
    torch.testing.assert_close(H, expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(mine.energy, theirs.energy, rtol=1e-6, atol=0)
    torch.testing.assert_close(mine.rms, theirs.rms, rtol=0, atol=1e-5)
    assert torch.equal(mine.kept, theirs.kept) and 0.3 < mine.kept.float().mean() < 1
    torch.testing.assert_close(my_grads[0], their_grads[0], rtol=1e-6, atol=0)
    assert (my_grads[1] - their_grads[1]).norm() <= 1e-6 * their_grads[1].norm()


def test_what_the_kernels_do_not_have_is_the_definition_s(some: Pairs) -> None:
    uneven = replace(residual_noise(), sigma_intensity=torch.linspace(3.0, 6.0, some.uv.shape[1]).double()[:, None])
    args = (some.points, some.gray, some.camera)
    mine, theirs = (f(*args, noise=uneven, steps=(3,)) for f in (align_pairs, pairs.align_pairs))
    assert torch.equal(mine.T_target_host, theirs.T_target_host)
    double = Target(0, some.gray.double(), some.camera)
    systems = [
        f(some.points, double, some.T, torch.zeros(len(some.T), 2), residual_noise())
        for f in (linearise_pairs, linearise.linearise_pairs)
    ]
    assert torch.equal(systems[0].H, systems[1].H)
    gray = some.host.clone().requires_grad_()
    assert host_points(gray, some.uv, some.inverse_depth).patch[1].requires_grad
    for f in (pick_points, points.pick_points):
        with pytest.raises(IdRgbdoError, match="pick_points"):
            f(some.host[0], some.host_depth[0], 10)
    with pytest.raises(IdRgbdoError, match="host_points: expected gray"):
        host_points(some.host[0], some.uv, some.inverse_depth)


def test_a_compiled_function_takes_a_search_and_its_gradient_whole(some: Pairs) -> None:
    def cost(x: Leaves) -> Tensor:
        aligned = asked(align_pairs, some, x, residual_noise(), 1)
        return off(aligned, some.T).square().sum() + torch.logdet(aligned.information).sum()

    whole = torch.compile(cost, fullgraph=True, backend="aot_eager")
    found = []
    for f in (cost, whole):
        x = leaves_of(some)
        value = f(x)
        value.backward()
        found.append((value.detach(), x["weight"].grad, x["gray"].grad))
    for mine, expected in zip(*found, strict=True):
        assert float(expected.norm()) > 0
        torch.testing.assert_close(mine, expected)


def test_operators_are_what_they_say(some: Pairs) -> None:
    x = leaves_of(some)
    task = pairs.pairs_task(
        replace(some.points, weight=x["weight"]), some.gray, some.camera, some.depth, some.T, None, (4, 4)
    )
    tensors = operators.list_of(task)
    numbers = operators.numbers_of(some.camera, task.noise)
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(operators.align, (tensors, numbers, [4, 4], 1, True), test_utils=checks)
    target = Target(1, tracking_pyramid(some.gray, 2)[1], some.camera)
    state = some.T, torch.zeros(len(some.T), 2).double()
    tensors = operators.list_of_linearisation(task.points, target, *state, task.noise, torch.ones(len(some.T)).double())
    torch.library.opcheck(operators.linearise, (tensors, [*numbers, 3.0], 1), test_utils=checks)


def test_vmap_over_guesses(some: Pairs) -> None:
    """Several guesses of the same pairs at once; one noise for each is refused."""
    guesses = torch.stack([retract(torch.full((6,), size).double(), some.T) for size in (0.0, 0.002)])
    pose = lambda T: align_pairs(some.points, some.gray, some.camera, depth=some.depth, T_guess=T).T_target_host
    together = torch.vmap(pose)(guesses)
    for k, guess in enumerate(guesses):
        assert torch.equal(together[k], pose(guess))
    sigmas = torch.tensor([3.0, 4.0])
    with pytest.raises(IdRgbdoError, match="one noise for all pairs"):
        torch.vmap(
            lambda s: (
                align_pairs(
                    some.points, some.gray, some.camera, noise=replace(residual_noise(), sigma_intensity=s)
                ).affine
            )
        )(sigmas)


def test_units_are_refused_and_broken_images_cost_their_pair(some: Pairs) -> None:
    with pytest.raises(IdRgbdoError, match=r"gray levels 0\.\.255"):
        align_pairs(some.points, some.gray / 255, some.camera)
    with pytest.raises(IdRgbdoError, match="expected metres"):
        align_pairs(some.points, some.gray, some.camera, depth=1000 * some.depth)
    clean = align_pairs(some.points, some.gray, some.camera, depth=some.depth)
    depth, gray = some.depth.clone(), some.gray.clone()
    depth[some.depth == 0] = torch.nan
    depth[0, ::9] = -1.0
    gray[2] = torch.nan
    spoilt = align_pairs(some.points, gray, some.camera, depth=depth)
    assert spoilt.ok.tolist() == [True, True, False, True, True]
    assert torch.equal(spoilt.T_target_host[3], clean.T_target_host[3])
    none = align_pairs(HostPoints(*cut(some.points, 0)), some.gray[:0], some.camera, depth=some.depth[:0])
    assert none.T_target_host.shape == (0, 4, 4)


def cut(host: HostPoints, B: int) -> tuple[Tensor | tuple[Tensor, ...], ...]:
    values = (host.uv, host.inverse_depth, host.variance, host.patch, host.gradient)
    return tuple(tuple(y[:B] for y in x) if isinstance(x, tuple) else x[:B] for x in values)
