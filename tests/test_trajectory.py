"""Timed poses: text round trips, errors with their line, association against brute force, alignment."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from idrgbdo_torch.definitions.se3 import exp
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.trajectory import (
    Trajectory,
    align,
    associate,
    nearest,
    quaternion_from_rotation,
    read_tum,
    rotation_from_quaternion,
    write_tum,
)


def random_poses(count: int, seed: int = 0) -> torch.Tensor:
    """(count, 4, 4) float64, rotations of every angle up to pi."""
    generator = torch.Generator().manual_seed(seed)
    axis = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)
    angle = torch.linspace(0, torch.pi, count, dtype=torch.float64)[:, None]
    v = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return exp(torch.cat([v, axis * angle], dim=1))


def test_rotations_survive_the_way_through_quaternions() -> None:
    R = random_poses(200)[:, :3, :3]
    quaternion = quaternion_from_rotation(R)
    assert quaternion.shape == (200, 4)
    assert bool((quaternion[:, 3] >= 0).all())
    torch.testing.assert_close(quaternion.norm(dim=1), torch.ones(200, dtype=torch.float64), rtol=0, atol=1e-14)
    torch.testing.assert_close(rotation_from_quaternion(quaternion), R, rtol=0, atol=1e-12)


def test_quaternion_order_is_x_y_z_w() -> None:
    half = 0.5**0.5
    quarter_about_z = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    expected = torch.tensor([0, 0, half, half], dtype=torch.float64)
    torch.testing.assert_close(quaternion_from_rotation(quarter_about_z), expected)
    torch.testing.assert_close(rotation_from_quaternion(3 * expected), quarter_about_z)


def test_text_round_trip(tmp_path: Path) -> None:
    times = 1_305_031_102 + torch.arange(50, dtype=torch.float64) / 30
    trajectory = Trajectory(times, random_poses(50))
    write_tum(tmp_path / "a.txt", trajectory)
    back = read_tum(tmp_path / "a.txt")
    torch.testing.assert_close(back.timestamps, times, rtol=0, atol=1e-6)
    torch.testing.assert_close(back.T_world_cam, trajectory.T_world_cam, rtol=0, atol=5e-9)
    write_tum(tmp_path / "b.txt", back)
    assert (tmp_path / "b.txt").read_bytes() == (tmp_path / "a.txt").read_bytes()


def test_reading_sorts_skips_invalid_poses_and_takes_the_last_of_equal_times(tmp_path: Path) -> None:
    lines = [
        "# comment",
        "",
        "2,0,0,0,0,0,0,1",
        "1\t9 9 9 0 0 0 1",
        "1 1 2 3 0 0 0 1",
        "3 0 0 0 0 0 0 0",
        "4 nan 0 0 0 0 0 1",
    ]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    trajectory = read_tum(tmp_path / "a.txt")
    assert trajectory.timestamps.tolist() == [1, 2]
    assert trajectory.positions.tolist() == [[1, 2, 3], [0, 0, 0]]
    assert "2 of the 5 poses of 'a.txt' are marked invalid and are left out" in trajectory.notes


def written(folder: Path, stamps: list[object], tail: str = "0 0 0 0 0 0 1") -> Path:
    path = folder / "a.txt"
    path.write_text("".join(f"{stamp} {k} {tail[2:]}\n" for k, stamp in enumerate(stamps)))
    return path


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        ([1612345678 + 0.25 * k for k in range(20)], None),
        ([0.25 * k for k in range(20)], None),
        (list(range(20)), None),  # numbers of frames
        ([1612345678000 + 250 * k for k in range(20)], "milliseconds"),
        ([f"{1612345678000 + 250 * k:.3f}" for k in range(20)], "milliseconds"),
        ([1612345678000000 + 250000 * k for k in range(20)], "microseconds"),
        ([1612345678000000000 + 250000000 * k for k in range(20)], "nanoseconds"),
        ([f"{1612345678 + k:d}e9" for k in range(20)], "nanoseconds"),
        ([5400000000000 + 250000000 * k for k in range(20)], "nanoseconds"),  # since the machine was started
        ([250000000 * k for k in range(20)], "nanoseconds"),  # since the recording was
        ([250000 * k for k in range(20)], "microseconds"),
    ],
)
def test_units_of_time_are_recognised_and_said(tmp_path: Path, stamps: list[object], unit: str | None) -> None:
    trajectory = read_tum(written(tmp_path, stamps))
    step = 1.0 if stamps == list(range(20)) or "e9" in str(stamps[0]) else 0.25
    torch.testing.assert_close(trajectory.timestamps.diff(), torch.full((19,), step).double(), rtol=0, atol=1e-6)
    said = () if unit is None else (f"the timestamps of 'a.txt' are {unit} and are read as such",)
    assert trajectory.notes == said
    assert trajectory.at(torch.arange(3)).notes == said


def test_numbers_of_poses_are_no_times(tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match="18295873486192640 and so on, one by one, which are numbers"):
        read_tum(written(tmp_path, [18295873486192640 + k for k in range(20)]))


def test_two_runs_in_one_file_are_refused_and_repetitions_said(tmp_path: Path) -> None:
    run = [0.1 * k for k in range(30)]
    for second in (run, run[:8], [time + 0.03 for time in run]):
        with pytest.raises(IdRgbdoError, match=r"at line 31 the time goes back .*two runs in one file; split it there"):
            read_tum(written(tmp_path, [*run, *second]))
    path = written(tmp_path, run)
    path.write_text(path.read_text() * 2)  # the same file twice does no harm
    trajectory = read_tum(path)
    assert len(trajectory) == 30 and "30 of the timestamps of 'a.txt' repeat an earlier one, with the same pose" in (
        trajectory.notes
    )
    trajectory = read_tum(written(tmp_path, [*run[:20], run[19], *run[20:]]))
    assert len(trajectory) == 30 and "1 of the timestamps" in trajectory.notes[0]
    assert float(trajectory.positions[19, 0]) == 20  # the last, as the TUM tools have it


def test_poses_out_of_order_are_sorted_and_said(tmp_path: Path) -> None:
    run = [0.1 * k for k in range(30)]
    for stamps in ([*run[15:], *run[:15]], run[::-1], [*run[:9], run[10], run[9], *run[11:]]):
        trajectory = read_tum(written(tmp_path, stamps))
        torch.testing.assert_close(trajectory.timestamps, torch.tensor(run, dtype=torch.float64))
        assert len(trajectory.notes) == 1 and "sorted by time" in trajectory.notes[0]
    assert read_tum(written(tmp_path, run)).notes == ()


@pytest.mark.parametrize("dialect", ["comma", "semicolon", "csv", "trailing", "bom", "utf16", "exponents", "windows"])
def test_dialects_of_text_give_the_same_poses(tmp_path: Path, dialect: str) -> None:
    trajectory = Trajectory(torch.arange(5, dtype=torch.float64) / 3, random_poses(5))
    path = tmp_path / "a.txt"
    write_tum(path, trajectory)
    expected = read_tum(path)
    lines = path.read_text().splitlines()[1:]
    text = "\n".join(lines)
    heading = "timestamp,tx,ty,tz,qx,qy,qz,qw\n"
    data = {
        "comma": text.replace(".", ",").encode(),
        "semicolon": text.replace(".", ",").replace(" ", ";").encode(),
        "csv": (heading + text.replace(" ", ",")).encode(),
        "trailing": text.replace(" ", ", ").replace("\n", ",\n").encode(),
        "bom": b"\xef\xbb\xbf" + text.encode(),
        "utf16": text.encode("utf-16"),
        "exponents": "\n".join("\t".join(f"{float(n):.12e}" for n in line.split()) for line in lines).encode(),
        "windows": text.replace("\n", "\r\n").encode(),
    }[dialect]
    path.write_bytes(data)
    torch.testing.assert_close(read_tum(path).timestamps, expected.timestamps)
    torch.testing.assert_close(read_tum(path).T_world_cam, expected.T_world_cam)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("1 2 3", "got 3 numbers"),
        ("1 0 0 0 0 0 zero 1", "'1 0 0 0 0 0 zero 1'"),
        ("1 0 0 0 0 0 0 2", "length 2"),
        ("1 inf 0 0 0 0 0 1", "finite"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, line: str, complaint: str) -> None:
    (tmp_path / "a.txt").write_text(f"# header\n0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(IdRgbdoError, match=r"a\.txt, line 3: ") as caught:
        read_tum(tmp_path / "a.txt")
    assert complaint in str(caught.value)


def test_missing_and_empty_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match=r"cannot read .*none\.txt"):
        read_tum(tmp_path / "none.txt")
    (tmp_path / "empty.txt").write_text("# nothing\n")
    with pytest.raises(IdRgbdoError, match="holds no pose"):
        read_tum(tmp_path / "empty.txt")


def test_trajectory_refuses_wrong_shapes_types_and_order() -> None:
    times, poses = torch.arange(3, dtype=torch.float64), random_poses(3)
    with pytest.raises(IdRgbdoError, match=r"T_world_cam: expected \(3, 4, 4\)"):
        Trajectory(times, poses[:2])
    with pytest.raises(IdRgbdoError, match="float64"):
        Trajectory(times.float(), poses)
    with pytest.raises(IdRgbdoError, match="increasing"):
        Trajectory(times.flip(0), poses)


def test_path_length_is_the_sum_of_steps() -> None:
    poses = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    poses[1, 0, 3], poses[2, :2, 3] = 3.0, torch.tensor([3.0, 4.0], dtype=torch.float64)
    assert Trajectory(torch.arange(3, dtype=torch.float64), poses).path_length_m() == 7


stamps = st.lists(st.integers(0, 40), min_size=0, max_size=6, unique=True).map(sorted)


@settings(max_examples=150, deadline=None)
@given(stamps, stamps)
def test_association_is_the_best_of_all_matchings(ticks_a: list[int], ticks_b: list[int]) -> None:
    limit = 5.5
    a, b = (torch.tensor(ticks, dtype=torch.float64) for ticks in (ticks_a, ticks_b))
    of_a, of_b = associate(a, b, limit)
    assert of_a.tolist() == sorted(set(of_a.tolist()))
    assert of_b.tolist() == sorted(set(of_b.tolist()))
    differences = (a[of_a] - b[of_b]).abs()
    assert bool((differences <= limit).all())
    assert (-len(of_a), float(differences.sum())) == best_matching(ticks_a, ticks_b, limit)


def best_matching(a: list[int], b: list[int], limit: float) -> tuple[int, float]:
    """(-pairs, sum of differences) of the best matching, by trying all."""
    best = (0, 0.0)
    for size in range(1, min(len(a), len(b)) + 1):
        for chosen_a in itertools.combinations(a, size):
            for chosen_b in itertools.combinations(b, size):
                differences = [abs(x - y) for x, y in zip(chosen_a, chosen_b, strict=True)]
                if max(differences) <= limit:
                    best = min(best, (-size, float(sum(differences))))
    return best


def test_cameras_half_a_period_apart_lose_no_frame() -> None:
    color = torch.arange(10, dtype=torch.float64) / 30
    depth = color - 0.0166 + 0.0004 * torch.tensor([0, 1, 2, 3, 4, 4, 3, 2, 1, 0])
    assert len(associate(color, depth)[0]) == 10


def test_nearest_takes_the_earlier_of_two() -> None:
    sorted_times = torch.tensor([0.0, 1.0, 2.0, 4.0])
    assert nearest(sorted_times, torch.tensor([-5.0, 0.4, 0.5, 3.0, 3.1, 9.0])).tolist() == [0, 0, 0, 2, 3, 3]


def test_alignment_recovers_a_known_motion() -> None:
    generator = torch.Generator().manual_seed(3)
    source = torch.randn(30, 3, generator=generator, dtype=torch.float64)
    for T in random_poses(10, seed=4):
        target = source @ T[:3, :3].T + T[:3, 3]
        torch.testing.assert_close(align(source, target), T, rtol=0, atol=1e-12)


def test_alignment_never_mirrors() -> None:
    generator = torch.Generator().manual_seed(5)
    source = torch.randn(30, 3, generator=generator, dtype=torch.float64)
    T = align(source, source * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64))
    assert float(torch.linalg.det(T[:3, :3])) == pytest.approx(1)


def test_alignment_is_the_least_squares_minimum() -> None:
    generator = torch.Generator().manual_seed(6)
    source, noise = (torch.randn(30, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    target = source + 0.3 * noise

    def cost(T: torch.Tensor) -> float:
        return float((source @ T[:3, :3].T + T[:3, 3] - target).square().sum())

    best = align(source, target)
    for direction in torch.eye(6, dtype=torch.float64):
        for step in (1e-3, -1e-3):
            assert cost(exp(step * direction) @ best) > cost(best)
