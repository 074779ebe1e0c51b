"""What a batch of pairs costs, points picked and sampled: beside the definition, and beside a loop over single ones."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
import pytest
import torch
from endless import back_and_forth
from pytest_benchmark.fixture import BenchmarkFixture
from rendered import Film
from torch import Tensor

from idrgbdo_torch import AlignedPairs, HostPoints, Pinhole, align_pairs, host_points, pick_points, residual_noise
from idrgbdo_torch.definitions import pairs as defined
from idrgbdo_torch.definitions import points as defined_points
from idrgbdo_torch.definitions.tracking import STEPS, prior_at
from idrgbdo_torch.frame import RgbdFrame, prepare
from idrgbdo_torch.kernels.tracking import align
from idrgbdo_torch.measurement import Aligned, MotionPrior, Points, State, Subset
from idrgbdo_torch.tracker import batch


@dataclass(frozen=True)
class Pairs:
    """Neighbouring frames."""

    gray: Tensor  # (B + 1, H, W)
    depth: Tensor
    camera: Pinhole


def neighbours(footage: Film, count: int) -> Pairs:
    """So many pairs."""
    frames = list(islice(back_and_forth(footage.frames), count + 1))
    gray, depth = (torch.stack([getattr(frame, name) for frame in frames]) for name in ("gray", "depth"))
    return Pairs(gray, depth, frames[0].camera)


def aligned(pairs: Pairs, points: int) -> AlignedPairs:
    """All of it by the package."""
    hosts = pairs.gray[:-1]
    host = host_points(hosts, *pick_points(hosts, pairs.depth[:-1], points))
    return align_pairs(host, pairs.gray[1:], pairs.camera, depth=pairs.depth[1:])


def aligned_by_definition(pairs: Pairs, points: int) -> AlignedPairs:
    """All of it by the definitions, which is how the package did it once."""
    hosts = pairs.gray[:-1]
    host = defined_points.host_points(hosts, *defined_points.pick_points(hosts, pairs.depth[:-1], points))
    return defined.align_pairs(host, pairs.gray[1:], pairs.camera, depth=pairs.depth[1:])


def one_by_one(pairs: Pairs, points: HostPoints) -> list[Aligned]:
    """A loop over single alignments by the kernel of the tracker."""
    every, _ = batch.kernel_points(points)
    noise = batch.kernel_noise_of(residual_noise(), True)
    eye, unknown, steps = np.eye(4), np.zeros((6, 6)), np.array(STEPS)
    affine_information = batch.double(prior_at(torch.eye(4)[None]).affine_information[0])
    out = []
    for b in range(len(points.uv)):
        frame = prepare(RgbdFrame(0.0, pairs.gray[b + 1], pairs.depth[b + 1], pairs.camera))
        one = Points(*(values[b] for values in every))
        there = Subset(np.flatnonzero(one.inv_depth > 0), one.patch.shape[2])
        prior = MotionPrior(eye, unknown, affine_information)
        out.append(align(frame.view, one, there, there, State(eye, np.zeros(2)), prior, noise, steps))
    return out


@pytest.mark.parametrize("points", [24, 256], ids="{:03}".format)
@pytest.mark.parametrize("count", [1, 32, 256, 1024], ids="{:04}".format)
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_align(device: str, count: int, points: int, full: bool, footage: Film, benchmark: BenchmarkFixture) -> None:
    benchmark.group = f"8 a batch: {count} pairs, picked, sampled and aligned"
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    if not full and count > 32:
        pytest.skip("the short form takes the smallest ones")
    pairs = neighbours(footage, count if full else min(count, 4))
    pairs = replace(pairs, gray=pairs.gray.to(device), depth=pairs.depth.to(device))
    benchmark.extra_info["pairs"] = len(pairs.gray) - 1
    assert benchmark(all_found, pairs, points)


def all_found(pairs: Pairs, points: int) -> bool:
    """Waits for a GPU."""
    return bool(aligned(pairs, points).ok.all())


@pytest.mark.parametrize("points", [24, 256])
def test_a_batch_is_as_fast_as_its_pairs(
    points: int, full: bool, footage: Film, ratio: Callable[[str, float], None]
) -> None:
    """32 pairs on one thread, processor time, the sides in turns: the least of each."""
    pairs = neighbours(footage, 32 if full else 2)
    hosts = pairs.gray[:-1]
    host = host_points(hosts, *pick_points(hosts, pairs.depth[:-1], points))
    alone = partial(align_pairs, host, pairs.gray[1:], pairs.camera, depth=pairs.depth[1:])
    sides: dict[str, Callable[[], object]] = {
        "all": partial(aligned, pairs, points), "definition": partial(aligned_by_definition, pairs, points),
        "batch": alone, "loop": partial(one_by_one, pairs, host),
    }  # fmt: skip
    least = dict.fromkeys(sides, np.inf)
    for turn in range(6 if full else 1):
        for name, side in sides.items():
            if turn < 2 or name != "definition":
                begin = time.process_time()
                side()
                least[name] = min(least[name], time.process_time() - begin)
    ratio(f"batch: the definition over the kernels, {points} points", least["definition"] / least["all"])
    ratio(f"batch: a pair on a core over the fused loop, {points} points", least["batch"] / least["loop"])
