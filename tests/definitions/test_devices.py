"""Every definition works where its inputs lie, and waits for nothing there: found without a GPU.

Tensors on the device "meta" have shapes and types, but no values. A constant made on the CPU does not go with them, as
it would not with a GPU's; and whatever looks at a value (bool, float, item) raises, where on a GPU it would wait. What
has to look at values gets them on the CPU, while "meta" is the default for everything that is made without a device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from idrgbdo_torch.definitions import (
    camera,
    image,
    information,
    pairs,
    photometric,
    points,
    removal,
    se3,
    selection,
    solver,
    tracking,
)
from idrgbdo_torch.definitions import linearise as lin
from idrgbdo_torch.definitions import marginalization as marginal

CAMERA = camera.Pinhole(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
B, N = 3, 20


class OneDevice(TorchDispatchMode):
    """Refuses operations between tensors of several devices, some of which "meta" lets pass, and copies to another."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor) and x.ndim]
        if len({x.device for x in given}) > 1:
            raise RuntimeError(f"{func}: tensors on more than one device")
        return func(*args, **(kwargs or {}))


@pytest.fixture(autouse=True)
def one_device() -> Iterator[None]:
    with OneDevice():
        yield


def there(*shape: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Numbers on a device that has none."""
    return torch.empty(*shape, dtype=dtype, device="meta")


def images() -> tuple[Tensor, Tensor]:
    return there(B, 48, 64, dtype=torch.float32), there(B, 48, 64, dtype=torch.float32)


def hosts(levels: int = 2) -> points.HostPoints:
    return points.host_points(images()[0], there(B, N, 2), there(B, N), weight=there(B, N), levels=levels)


def warped() -> photometric.Warp:
    return photometric.warp(CAMERA, there(B, N, 2), there(B, N), there(B, 1, 4, 4), slope=there(B, N, 2))


def a_system() -> lin.NormalEquations:
    gray, depth = images()
    target = lin.Target(1, points.tracking_pyramid(gray, 2)[1], CAMERA, pairs.inverse_of(depth))
    scale = lin.robust_scale(there(B, N))
    return lin.linearise_pairs(hosts(), target, there(B, 4, 4), there(B, 2), lin.residual_noise(), scale, 3.0)


def alignment(gradient_steps: int) -> pairs.AlignedPairs:
    gray, depth = images()
    leaf = there(B, N).requires_grad_(gradient_steps > 0)
    host = replace(hosts(), weight=leaf)
    guess = tracking.prior_at(there(B, 4, 4))
    task = pairs.pairs_task(host, gray, CAMERA, depth, guess, None, (3, 2))
    aligned = pairs.aligned_by_definition(task, gradient_steps)
    if gradient_steps:
        (slope,) = torch.autograd.grad(se3.log(aligned.T_target_host).sum(), leaf)
        assert slope.device.type == "meta"
    return aligned


DEFINITIONS: dict[str, Callable[[], object]] = {
    "se3": lambda: se3.log(se3.retract(there(B, 6), se3.inverse(there(B, 4, 4)))),
    "se3.adjoint": lambda: se3.adjoint(there(B, 4, 4)),
    "camera": lambda: camera.project(CAMERA, camera.backproject(CAMERA, there(B, N, 2), there(B, N))),
    "camera's Jacobians": lambda: (
        camera.duv_dP(CAMERA, there(B, 3)),
        camera.dP_dinverse_depth(CAMERA, there(B, 2), there(B)),
        camera.inside(CAMERA, there(B, 2), 2.0),
    ),
    "image": lambda: (image.gradient(images()[0]), image.sample_surface(images()[1], there(B, N, 2))),
    "image.sample_bilinear": lambda: image.sample_bilinear(images()[0], there(B, N, 2)),
    "photometric": lambda: photometric.linearize(images()[0], warped(), there(B, N, 8), there(B, 1, 2)),
    "photometric.depth": lambda: photometric.depth_residual(images()[1].double(), warped()),
    "photometric.variance": lambda: photometric.residual_variance(
        photometric.distortion_weight(photometric.projective_distortion(there(N), there(N, 3), there(4, 4)))[0],
        photometric.photometric_variance(there(N, 8, 2), there(N, 2), there(N)),
    ),
    "photometric.information": lambda: photometric.gradient_information(there(N, 8, 2), there(N, 8)),
    "information": lambda: information.information_from_rows(there(B, N, 6), there(B, N)),
    "information.split": lambda: information.split_joint(there(6, 6), 3),
    "solver": lambda: solver.solve(*solver.normal_equations(there(B, N, 8), there(B, N), there(B, N)), there(B)).y,
    "solver.brightness": lambda: solver.pose_information(
        there(B, 8, 8), solver.brightness_information(there(B, 8, 8), there(B, 2, 2))
    ),
    "solver.weights": lambda: (solver.huber_weight(there(N), 2.0, 9.0), solver.robust_cost(there(N), 2.0, 9.0)),
    "points": lambda: (points.pick_points(*images(), 20), hosts(), points.tracking_pyramid(images()[0], 3)),
    "linearise_pairs": a_system,
    "align_pairs": lambda: alignment(0),
    "align_pairs with its gradient": lambda: alignment(1),
    "align_pairs unrolled": lambda: alignment(2),
    "tracking.motion_prior": lambda: tracking.motion_prior_terms(there(B, 6), there(B, 6), there(6, 6)),
    "selection.value": lambda: selection.point_value(there(N), there(N), 0.5, 20.0),
    "removal": lambda: removal.next_view_bits(there(12, 12), there(2, 6, 6), there(2, 6, 6)),
    "marginalization.prior": lambda: marginal.prior_gradient(marginal.LinearPrior(there(6, 6), there(6)), there(6)),
}


def devices_of(result: object) -> set[str]:
    """Of all tensors in a result."""
    if isinstance(result, Tensor):
        return {result.device.type}
    values = result if isinstance(result, tuple | list) else getattr(result, "__dict__", {}).values()
    return set().union(*(devices_of(value) for value in values)) if values else set()


@pytest.mark.parametrize("name", list(DEFINITIONS))
def test_a_definition_works_where_its_inputs_lie_and_waits_for_nothing(name: str) -> None:
    assert devices_of(DEFINITIONS[name]()) == {"meta"}


def test_a_constant_made_elsewhere_and_a_look_at_a_value_are_found() -> None:
    """The check itself: it would notice."""
    for mixed in (lambda: there(3) + torch.ones(3), lambda: there(3, 3) @ torch.eye(3).double()):
        with pytest.raises(RuntimeError, match="device"):
            mixed()
    with pytest.raises(RuntimeError):
        bool(there(3).any())


def some(*shape: int) -> Tensor:
    """Values on the CPU."""
    return torch.rand(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.1


def definite(n: int) -> Tensor:
    return some(n, n) @ some(n, n).mT + torch.eye(n, dtype=torch.float64)


ROWS, MATRIX, LARGE = some(N, 3, 6), definite(6), definite(12)
GRAY, DEPTH = (200 * some(B, 48, 64)).float(), some(B, 48, 64).float()
CELLS, HALF = torch.arange(N) % 7, torch.arange(12) < 6
LOOKING: dict[str, Callable[[], object]] = {
    "select_rows": lambda: selection.select_rows(ROWS, 8, sigma=ROWS[:, 0, 0], cells=CELLS),
    "select_rows with a prior": lambda: selection.select_rows(
        ROWS, 8, information=MATRIX, where=ROWS[:, 0, :2], distance=0.01, radius=ROWS[:, 0, 0]
    ),
    "select_rows of none": lambda: selection.select_rows(ROWS[:0], 8),
    "determinant_gain": lambda: selection.determinant_gain(ROWS, MATRIX),
    "entropy": lambda: (information.entropy_bits(MATRIX), information.mutual_information_bits(MATRIX, 3)),
    "freedom_entropies": lambda: information.freedom_entropies_bits(MATRIX),
    "marginalize": lambda: marginal.marginalize(LARGE, LARGE[0], HALF),
    "redundancy": lambda: marginal.redundancy_bits(LARGE),
    "align_pairs": lambda: pairs.align_pairs(
        points.host_points(GRAY, *points.pick_points(GRAY, DEPTH, 20), levels=2), GRAY, CAMERA, depth=DEPTH,
        steps=(2, 2),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(LOOKING))
def test_what_looks_at_values_makes_nothing_on_another_device(name: str) -> None:
    with torch.device("meta"):
        assert devices_of(LOOKING[name]()) == {"cpu"}
