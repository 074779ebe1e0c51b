"""Attacks on the functions of docs/api.md: whatever they are handed, they answer or refuse in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.random import Generator

import idrgbdo_torch as api
from idrgbdo_torch.config import SelectionConfig
from idrgbdo_torch.definitions.photometric import PATTERN

from .frames import film, nonsense, other_form, other_values
from .promise import refused

Call = tuple[Callable[..., Any], tuple[Any, ...]]


@cache
def calls() -> tuple[Call, ...]:
    """Every public function with arguments that it takes."""
    frames = film()[:3]
    camera = frames[0].camera
    gray, depth = torch.stack([f.gray for f in frames]), torch.stack([f.depth for f in frames])
    uv, inverse_depth = api.pick_points(gray[:-1], depth[:-1], 30)
    points = api.host_points(gray[:-1], uv, inverse_depth)
    T = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    noise, affine = api.residual_noise(), torch.zeros(2, 2, dtype=torch.float64)
    rows = torch.rand(50, 2, 6, dtype=torch.float64)
    information = torch.eye(6, dtype=torch.float64)
    one = uv[0].double(), inverse_depth[0].double()
    warped = api.warp(camera, *one, T[0])
    patch = torch.full((len(one[0]), len(PATTERN)), 100.0, dtype=torch.float64)
    times = torch.arange(9.0, dtype=torch.float64) / 10
    track = api.Trajectory(times, torch.eye(4, dtype=torch.float64).repeat(9, 1, 1))
    return (
        (api.warp, (camera, *one, T[0])),
        (api.linearize, (gray[1].double(), warped, patch, affine[0])),
        (api.pick_points, (gray[:-1], depth[:-1], 30)),
        (api.host_points, (gray[:-1], uv, inverse_depth)),
        (api.tracking_pyramid, (gray, 3)),
        (api.align_pairs, (points, gray[1:], camera)),
        (api.linearise_pairs, (points, api.Target(0, gray[1:], camera), T, affine, noise)),
        (api.residual_noise, ()),
        (api.select_rows, (rows, 10)),
        (api.information_from_rows, (rows[:, 0], torch.ones(50))),
        (api.entropy_bits, (information,)),
        (api.entropy_reduction_bits, (information, information)),
        (api.mutual_information_bits, (information, 3)),
        (api.conditional_covariance, (information, 3)),
        (api.Trajectory, (times, track.T_world_cam)),
        (api.evaluate, (track, track)),
        (pinhole, (160, 120, 140.0, 140.0, 79.5, 59.5)),
        (api.BrokenFrame, (0.0, "gone")),
        (api.RgbdFrame, (0.0, frames[0].gray, frames[0].depth, camera)),
        (api.IdRgbdo, (api.Config(),)),
        (api.IdRgbdo, (api.Config(selection=SelectionConfig(points=30)),)),
        (api.run, (api.IdRgbdo(), frames[:1])),
    )


def doors(rng: Generator, folder: Path) -> None:
    """One or two arguments are something else."""
    every = calls()
    function, arguments = every[int(rng.integers(len(every)))]
    given = list(arguments)
    for place in set(rng.integers(0, len(given), 2).tolist()) if given else ():
        given[place] = something_else(rng, given[place])
    refused(lambda: function(*given))


def files(rng: Generator, folder: Path) -> None:
    """Trajectories read from and written to what is no file."""
    _, (track, _) = next(call for call in calls() if call[0] is api.evaluate)
    places: tuple[Any, ...] = (folder, folder / "none" / "x.txt", str(folder), "\x00", "", "x" * 5000, None, 7, b"/")
    place = places[int(rng.integers(len(places)))]
    refused(lambda: api.write_tum(place, track))
    refused(lambda: api.read_tum(place))


def something_else(rng: Generator, value: Any) -> Any:
    """Another value in the place of one, near to it or far."""
    if isinstance(value, torch.Tensor) and rng.random() < 0.8:
        if value.is_sparse or value.is_quantized or value.is_nested or value.dim() < 2:
            return None
        return other_form(rng, value) if rng.random() < 0.6 else other_values(rng, value).to(value.dtype)
    if isinstance(value, int | float) and rng.random() < 0.7:
        return (0, -1, 7.5, np.nan, np.inf, 10**30, "7", True, np.int64(3))[int(rng.integers(9))]
    if isinstance(value, tuple) and hasattr(value, "_replace") and rng.random() < 0.8:
        name = value._fields[int(rng.integers(len(value._fields)))]
        return value._replace(**{name: something_else(rng, getattr(value, name))})
    return (None, "x", 7, [], {}, object(), nonsense(rng, value), np.zeros((2, 2)), api.Config, folderless)[
        rng.integers(10)
    ]


def pinhole(*numbers: Any) -> api.Pinhole:
    """A camera, by position."""
    return api.Pinhole(**dict(zip(("width", "height", "fx", "fy", "cx", "cy"), numbers, strict=True)))


def folderless() -> None:
    """A function, for where one is not expected."""
