"""The poses of a log belong to the images that they were made for, whatever is missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import format_writers
import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.poses import by_frame
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.odometry import run


def log(numbers: Iterable[int]) -> dict[int, np.ndarray]:
    """Poses that know their number."""
    return {number: np.full((4, 4), float(number)) for number in numbers}


FULL = list(range(75))
CASES: dict[str, tuple[Iterable[int], list[int], list[int], Callable[[int], int], bool]] = {
    # poses, frames, images, the pose of a frame, whether there is something to say
    "complete": (FULL, FULL, FULL, lambda n: n, False),
    "one depth image missing": (FULL, [n for n in FULL if n != 10], FULL, lambda n: n, False),
    "depth started late": (FULL, FULL[10:], FULL, lambda n: n, False),
    "both started late": (FULL, FULL[10:], FULL[10:], lambda n: n, False),
    "from 1, colour 20 missing": (
        FULL,
        [n + 1 for n in FULL if n != 20],
        [n + 1 for n in FULL],
        lambda n: n - 1,
        False,
    ),
    "from 1, the last five missing": (FULL, list(range(1, 71)), list(range(1, 71)), lambda n: n - 1, False),
    "every second": (FULL, FULL[::2], FULL[::2], lambda n: n, False),
    "both of some missing": (FULL, [n for n in FULL if n % 7], [n for n in FULL if n % 7], lambda n: n, True),
    "part of a recording, log of it all": (
        range(2480),
        list(range(880, 1080)),
        list(range(880, 1080)),
        lambda n: n,
        False,
    ),
    "part of a recording, log of the part": (
        range(200),
        list(range(880, 1080)),
        list(range(880, 1080)),
        lambda n: n - 880,
        False,
    ),
    "that part with gaps": (
        range(200),
        [n for n in range(880, 1080) if n % 3],
        list(range(880, 1080)),
        lambda n: n - 880,
        False,
    ),
    "log that counts from 1": (range(1, 76), list(range(1, 76)), list(range(1, 76)), lambda n: n, False),
    "a pose for each image that is there": (range(38), FULL[::2], FULL[::2], lambda n: n // 2, True),
    "a pose for each frame that is there": (
        range(74),
        [n for n in FULL if n != 10],
        FULL,
        lambda n: n - (n > 10),
        True,
    ),
    "log that ends early": (range(50), FULL[:50], FULL, lambda n: n, True),
}


@pytest.mark.parametrize("case", CASES)
def test_each_frame_has_its_own_pose(case: str) -> None:
    poses, frames, images, expected, said = CASES[case]
    found, warnings = by_frame(log(poses), frames, images)
    assert {number: int(T[0, 0]) for number, T in found.items()} == {n: expected(n) for n in frames}
    assert bool(warnings) == said


@pytest.mark.parametrize(
    ("gone", "offset"), [([("depth", 4)], 0), ([("depth", n) for n in range(6)], 0), ([("color", 5)], 1)]
)
def test_a_run_is_evaluated_against_the_poses_of_its_own_frames(
    desk: Film, tmp_path: Path, gone: list[tuple[str, int]], offset: int
) -> None:
    """In Open3D's layout; each reference pose is the film's at the same number."""
    film = Film(desk.frames[:16], desk.groundtruth)
    format_writers.redwood(film, tmp_path)
    for kind in ("color", "depth"):
        for path in sorted((tmp_path / kind).iterdir(), reverse=True):
            number = int(path.stem)
            if (kind, number) in gone:
                path.unlink()
            else:
                path.rename(path.with_name(f"{number + offset:06}{path.suffix}"))
    sequence = open_sequence(tmp_path)
    missing = {number for _, number in gone}
    assert sequence.groundtruth is not None
    kept = [n for n in range(16) if n not in missing]
    np.testing.assert_allclose(
        sequence.groundtruth.T_world_cam.numpy(), desk.groundtruth.T_world_cam[kept].numpy(), atol=1e-9
    )
    assert len(sequence.warnings) == 1  # of the images without partner
    assert evaluate(run(IdRgbdo(), sequence).trajectory(), sequence.groundtruth).ate.rmse_m < 0.004
