"""Eqs. 17 and 18 against brute force, Algorithm 1 against an independent oracle, and the four modes on a desk."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from rendered import Film
from torch import Tensor

from idrgbdo_torch.config import Config, Mode, SelectionConfig
from idrgbdo_torch.definitions.information import log2_det
from idrgbdo_torch.definitions.photometric import warp
from idrgbdo_torch.definitions.selection import determinant_gain, gain_bits, point_value, select_informative
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import Keyframe, prepare
from idrgbdo_torch.kernels import selection as choice
from idrgbdo_torch.measurement import Rows, kernel_noise
from idrgbdo_torch.tracker.backends import backend_named
from idrgbdo_torch.tracker.keyframe import make_keyframe
from idrgbdo_torch.tracker.selection import grid_cells, point_bits, select_points
from idrgbdo_torch.tracker.tracking import motion_information

FUSED = backend_named("fused")
NOISE = kernel_noise(Config().noise)
PRIOR = motion_information(Config(), 1 / 30)


def spd(generator: torch.Generator, n: int = 6) -> Tensor:
    J = torch.randn(2 * n, n, generator=generator, dtype=torch.float64)
    return J.mT @ J


def adjugate(M: Tensor) -> Tensor:
    """By its minors, without inverting anything."""
    n = len(M)
    cofactors = torch.empty_like(M)
    for i in range(n):
        for j in range(n):
            rows, columns = [r for r in range(n) if r != i], [c for c in range(n) if c != j]
            cofactors[i, j] = (-1) ** (i + j) * torch.linalg.det(M[rows][:, columns])
    return cofactors.mT


@pytest.mark.parametrize("R", [1, 2, 3, 8])
def test_determinant_gain_is_the_difference_of_determinants(R: int) -> None:
    generator = torch.Generator().manual_seed(R)
    information = spd(generator)
    rows = torch.randn(5, 4, R, 6, generator=generator, dtype=torch.float64)
    after = torch.linalg.det(information + rows.mT @ rows)
    expected = after - torch.linalg.det(information)
    assert expected.shape == (5, 4) and (expected > 0).all()
    torch.testing.assert_close(determinant_gain(rows, information), expected)
    torch.testing.assert_close(gain_bits(rows, information), 0.5 * torch.log2(after / torch.linalg.det(information)))


def test_determinant_gain_of_a_row_is_the_printed_form() -> None:
    generator = torch.Generator().manual_seed(0)
    information = spd(generator)
    j = torch.randn(6, generator=generator, dtype=torch.float64)
    variance = 0.3
    printed = j @ adjugate(information) @ j / variance
    torch.testing.assert_close(determinant_gain(j[None] / variance**0.5, information), printed)


def test_determinant_gain_of_a_pose_in_metres_and_radians() -> None:
    """Determinants of 1e41, and a point that adds a millionth: nothing overflows and nothing cancels."""
    generator = torch.Generator().manual_seed(0)
    information = 1e7 * spd(generator)
    row = 1e-3 * torch.randn(1, 6, generator=generator, dtype=torch.float64)
    small = row @ torch.linalg.inv(information) @ row.mT
    assert torch.linalg.det(information) > 1e41 and small < 1e-12
    torch.testing.assert_close(gain_bits(row, information), small[0, 0] / (2 * np.log(2)), rtol=1e-2, atol=0)


def test_a_gain_in_bits_has_no_units() -> None:
    generator = torch.Generator().manual_seed(1)
    information, rows = spd(generator), torch.randn(9, 3, 6, generator=generator, dtype=torch.float64)
    unit = torch.tensor([1e3, 1e3, 1e3, 57.3, 57.3, 57.3], dtype=torch.float64)
    torch.testing.assert_close(gain_bits(rows * unit, unit[:, None] * information * unit), gain_bits(rows, information))


def test_gains_shrink_as_points_join() -> None:
    """Submodular: what makes a stale gain a bound in the lazy choice."""
    generator = torch.Generator().manual_seed(2)
    information, rows = spd(generator), torch.randn(50, 2, 6, generator=generator, dtype=torch.float64)
    before = gain_bits(rows, information)
    assert (gain_bits(rows, information + rows[0].mT @ rows[0]) < before).all()


def test_value_of_a_point() -> None:
    gain = torch.tensor([2.0, 1.0, 5.0], dtype=torch.float64)
    radius = torch.tensor([0.5, 0.7, 0.0], dtype=torch.float64)
    expected = torch.tensor([2 + 1, 1 + 1 / (25 * 0.04 + 1), 5 + 1 / (25 * 0.25 + 1)], dtype=torch.float64)
    torch.testing.assert_close(point_value(gain, radius, 0.5, 25.0), expected)
    torch.testing.assert_close(point_value(gain, radius, 0.5, 25.0, spread=0.2), gain + 0.2 * (expected - gain))


def oracle(rows: np.ndarray, radius: np.ndarray, m: int, start: np.ndarray, objective: str, where: np.ndarray,
           distance: float, spread: float, c_z: float) -> list[int]:  # fmt: skip
    """Algorithm 1 as printed: arg max over every free point, determinants recomputed each time."""
    N, _, D = rows.shape
    information, chosen = start.copy(), []

    def free() -> list[int]:
        near = lambda p: any(np.hypot(*(where[p] - where[q])) < distance for q in chosen)
        return [p for p in range(N) if p not in chosen and not near(p)]

    def worth(p: int, z: float) -> float:
        after, before = (np.linalg.slogdet(M)[1] for M in (information + rows[p].T @ rows[p], information))
        near = 1 / (c_z * (radius[p] - z) ** 2 + 1)
        return float(
            (after - before) / np.log(4) + spread * near
            if objective == "bits"
            else np.exp(after) - np.exp(before) + near
        )

    for k in range(D):
        if free() and len(chosen) < m:
            best = max(free(), key=lambda p, k=k: np.linalg.norm(rows[p, :, k]))
            information += rows[best].T @ rows[best]
            chosen.append(best)
    z, dz = 1.0, 1 / max(1, m - D)
    while free() and len(chosen) < m:
        best = max(free(), key=lambda p: worth(p, z))
        information += rows[best].T @ rows[best]
        chosen.append(best)
        z = max(0.0, z - dz)
    return chosen


@pytest.mark.parametrize("objective", ["bits", "paper"])
@pytest.mark.parametrize(
    ("R", "D", "m", "distance"), [(1, 6, 12, 0.0), (3, 6, 24, 10.0), (2, 4, 3, 0.0), (1, 6, 99, 20.0)]
)
def test_algorithm_1(objective: Literal["bits", "paper"], R: int, D: int, m: int, distance: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        rows = 0.25 * rng.standard_normal((70, R, D))  # small enough for the printed spread term to decide
        radius, where, start = rng.uniform(0, 1, 70), rng.uniform(0, 100, (70, 2)), np.diag(rng.uniform(0.3, 1, D))
        expected = oracle(rows, radius, m, start, objective, where, distance, 0.4, 25.0)
        chosen = select_informative(
            torch.from_numpy(rows), torch.from_numpy(radius), m, torch.from_numpy(start),
            SelectionConfig(objective=objective, spread=0.4, distance=distance), torch.from_numpy(where),
        )  # fmt: skip
        assert chosen.tolist() == expected
        assert m == 99 or len(expected) == m


def test_choice_does_not_change_its_input_and_takes_float32() -> None:
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(30, 1, 6, generator=generator)
    radius, information = torch.rand(30, generator=generator), torch.eye(6)
    copies = [x.clone() for x in (rows, radius, information)]
    chosen = select_informative(rows, radius, 10, information)
    assert len(set(chosen.tolist())) == 10
    assert all(torch.equal(x, y) for x, y in zip((rows, radius, information), copies, strict=True))


@pytest.mark.parametrize(
    ("shape", "D", "m"), [((10, 6), 6, 4), ((10, 1, 6), 5, 4), ((10, 1, 6), 6, 0)], ids=["rows", "information", "m"]
)
def test_bad_input_says_what_to_do(shape: tuple[int, ...], D: int, m: int) -> None:
    with pytest.raises(IdRgbdoError, match=r"rows: expected \(N, R, D\) .* got .*; a single Jacobian row") as error:
        select_informative(torch.zeros(shape), torch.zeros(10), m, torch.eye(D))
    assert "\n" not in str(error.value)


def test_nothing_to_choose_from() -> None:
    nothing = Rows(np.zeros((0, 3, 6)), np.zeros(0, np.bool_), np.zeros((0, 2)))
    none = choice.select(nothing, np.zeros(0), 24, 24, np.eye(6), 0.0, 0.5, 25.0, 6.0)
    assert none.tolist() == []
    assert select_informative(torch.zeros(0, 3, 6), torch.zeros(0), 24, torch.eye(6)).tolist() == []


def test_grid_cells_are_squares_of_the_asked_number() -> None:
    v, u = np.mgrid[:240, :320]
    cells = grid_cells(np.column_stack([u.ravel(), v.ravel()]).astype(float), 48, 320, 240)
    numbers, sizes = np.unique(cells, return_counts=True)
    assert len(numbers) == 48 and set(sizes) == {1600}


def keyframe_of(desk: Film, mode: Mode, seed: int = 0) -> Keyframe:
    config = replace(Config(), selection=SelectionConfig(mode=mode))
    return make_keyframe(prepare(desk.frames[0]), config, np.random.default_rng(seed), FUSED)


def bits_of(keyframe: Keyframe, T: np.ndarray, index: np.ndarray) -> float:
    """log2 of what the determinant of the information grows by, halved."""
    camera = keyframe.frame.camera
    A, _, _ = choice.whitened_rows(
        keyframe.frame.intrinsics[0], camera.width, camera.height, 0.0, keyframe.points, index, T, NOISE
    )
    information = torch.from_numpy(PRIOR + (A.transpose(0, 2, 1) @ A).sum(axis=0))
    return float(log2_det(information) - log2_det(torch.from_numpy(PRIOR))) / 2


MODES: list[Mode] = ["rand", "grid", "inf", "inf+grid"]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("m", [24, 100])
def test_every_mode_keeps_the_rules(desk: Film, mode: Mode, m: int) -> None:
    T = desk.T(8, 0)
    keyframe = keyframe_of(desk, mode)
    config = SelectionConfig(mode=mode)
    index = select_points(keyframe, T.numpy(), m, PRIOR, config, NOISE, np.random.default_rng(0), FUSED)
    assert len(np.unique(index)) == len(index) == m
    centre = warp(
        keyframe.frame.camera, torch.from_numpy(keyframe.points.uv[index]),
        torch.from_numpy(keyframe.points.inv_depth[index]), T,
    ).centre  # fmt: skip
    assert centre.min() >= config.margin
    assert centre[:, 0].max() <= 319 - config.margin and centre[:, 1].max() <= 239 - config.margin
    if mode.startswith("inf"):
        gaps = torch.cdist(centre, centre) + 1e9 * torch.eye(m)
        assert gaps.min() >= config.distance - 1e-9
    seeds = (
        select_points(keyframe, T.numpy(), m, PRIOR, config, NOISE, np.random.default_rng(s), FUSED) for s in (0, 1)
    )
    same, other = (np.array_equal(index, again) for again in seeds)
    assert same and other == (mode != "rand")


def test_grid_takes_the_strongest_of_every_cell_first(desk: Film) -> None:
    keyframe = keyframe_of(desk, "grid")
    config = SelectionConfig(mode="grid", margin=0.0)
    index = select_points(keyframe, np.eye(4), 24, PRIOR, config, NOISE, np.random.default_rng(0), FUSED)
    strength = (keyframe.points.gradient[0, :, 0] ** 2).sum(axis=1)
    cells = grid_cells(keyframe.points.uv, 24, 320, 240)
    assert len(np.unique(cells[index])) >= 20
    for p in index:
        rivals = strength[cells == cells[p]]
        first = p == index[cells[index] == cells[p]][0]
        assert not first or strength[p] == rivals.max()


def test_information_beats_the_grid_and_the_grid_beats_chance(desk: Film) -> None:
    """In bits of the pose with 24 points, at the keyframe itself and at a later frame."""
    for frame in (0, 8):
        T = desk.T(frame, 0).numpy()
        bits = {}
        for mode in MODES:
            each = []
            for seed in range(5 if mode == "rand" else 1):
                keyframe = keyframe_of(desk, mode, seed)
                index = select_points(
                    keyframe, T, 24, PRIOR, SelectionConfig(mode=mode), NOISE, np.random.default_rng(seed), FUSED
                )
                each.append(bits_of(keyframe, T, index))
            bits[mode] = float(np.mean(each))
        assert bits["inf"] > bits["inf+grid"] - 0.5
        assert bits["inf+grid"] > bits["grid"] + 0.5
        assert bits["grid"] > bits["rand"] + 0.5


def test_spread_and_the_paper_objective_are_options(desk: Film) -> None:
    keyframe, T = keyframe_of(desk, "inf+grid"), np.eye(4)
    choose = lambda **options: select_points(
        keyframe, T, 24, PRIOR, SelectionConfig(**options), NOISE, np.random.default_rng(0), FUSED
    )
    greedy = choose(spread=0.0)
    assert bits_of(keyframe, T, greedy) > bits_of(keyframe, T, choose(spread=20.0))
    # with its literal second term of at most 1 beside 1e30 and more, the printed objective is the greedy choice
    assert choose(objective="paper").tolist() == greedy.tolist()


def test_too_few_in_view_gives_what_there_is(desk: Film) -> None:
    away = np.eye(4)
    away[0, 3] = -1.9  # the camera moves right: little of the keyframe is left in view
    for mode in MODES:
        keyframe = keyframe_of(desk, mode)
        config = SelectionConfig(mode=mode)
        some = select_points(keyframe, away, 1000, PRIOR, config, NOISE, np.random.default_rng(0), FUSED)
        assert len(np.unique(some)) == len(some) < 300
        behind = np.diag([-1.0, 1.0, -1.0, 1.0])
        assert len(select_points(keyframe, behind, 24, PRIOR, config, NOISE, np.random.default_rng(0), FUSED)) == 0


def test_bits_of_a_point_are_what_would_be_lost_without_it(desk: Film) -> None:
    keyframe, T = keyframe_of(desk, "inf+grid"), desk.T(5, 0).numpy()
    index = select_points(keyframe, T, 24, PRIOR, SelectionConfig(), NOISE, np.random.default_rng(0), FUSED)
    uv, bits = point_bits(keyframe, T, index, NOISE, FUSED)
    camera = keyframe.frame.camera
    A, seen, where = choice.whitened_rows(
        keyframe.frame.intrinsics[0], camera.width, camera.height, 0.0, keyframe.points, index, T, NOISE
    )
    assert seen.all() and np.array_equal(uv, where)
    each = torch.from_numpy(A.transpose(0, 2, 1) @ A)
    everything = each.sum(dim=0)
    lost = [0.5 * float(log2_det(everything) - log2_det(everything - own)) for own in each]
    torch.testing.assert_close(bits, torch.tensor(lost).double(), rtol=1e-3, atol=1e-4)
    one, bits = point_bits(keyframe, T, index[:1], NOISE, FUSED)
    assert one.shape == (1, 2) and torch.isfinite(bits).all() and bits > 0
