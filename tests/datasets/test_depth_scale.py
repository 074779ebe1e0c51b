"""Depth values per metre: what is believed, what is doubted and with which advice; holes filled with a constant."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from faults import Recording
from rendered import Film

from idrgbdo_torch.check import Verdict, check
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.depth_scale import scale_doubt
from idrgbdo_torch.frame import RgbdFrame


@pytest.mark.parametrize(
    ("median_m", "scale"),
    [(1.5, 1000), (1.5, 5000), (0.21, 1), (0.06, 1), (4.4, 10000), (0.5, 256)],
)
def test_usual_depth_and_close_range_in_metres_are_not_doubted(median_m: float, scale: float) -> None:
    assert scale_doubt(median_m, scale) is None


@pytest.mark.parametrize(
    ("true_m", "true_scale", "read_with", "wrong"),
    [
        (1.5, 4000, 1000, True),  # RealSense L515
        (1.5, 10000, 1000, True),  # RealSense D405
        (1.5, 256, 1000, False),  # VOID: 0.38 m could be a close-range scan
        (1.5, 1000, 5000, True),
        (1.5, 5000, 1000, True),
        (1.5, 1000, 1, True),
        (1.5, 6553.5, 1000, True),
        (0.25, 1000, 1000, False),  # close-range scans
        (0.25, 10000, 10000, False),
        (0.3, 4000, 4000, False),
        (8.0, 1, 1, False),  # a hall, floats
        (0.01, 1000, 1000, True),  # no camera
        (90.0, 1, 1, True),
    ],
)
def test_the_right_scale_is_among_the_likely_ones(
    true_m: float, true_scale: float, read_with: float, wrong: bool
) -> None:
    doubt = scale_doubt(true_m * true_scale / read_with, read_with)
    assert doubt is not None
    assert doubt.wrong == wrong
    if true_scale != read_with:
        assert f"{true_m:.2g} m with {true_scale:g} (" in doubt.advice
    if true_m * true_scale == 6000:  # as many as fit, none called right
        assert all(f" {scale:g} (" in doubt.advice for scale in (4000, 5000, 10000))


def recording(folder: Path, depths: list[np.ndarray], camera: str = "") -> Path:
    for number, depth in enumerate(depths):
        for kind in ("rgb", "depth"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
        color = np.random.default_rng(number).integers(0, 256, (*depth.shape, 3), np.uint8)
        cv2.imwrite(str(folder / "rgb" / f"{number:04}.png"), color)
        if depth.dtype == np.uint16:
            cv2.imwrite(str(folder / "depth" / f"{number:04}.png"), depth)
        else:
            np.save(folder / "depth" / f"{number:04}.npy", depth)
    (folder / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n" + camera)
    return folder


def slopes(frames: int = 3) -> list[np.ndarray]:
    """(48, 64) m, floors from 1 to 3 m, another in each frame."""
    floor = np.linspace(1.0, 3.0, 48)[:, None] + np.zeros((1, 64))
    return [floor + 0.05 * number for number in range(frames)]


@pytest.mark.parametrize("camera", ["", "depth_scale = 1000\n", "depth_scale = 5000\n", "depth_scale = 1\n"])
def test_floats_are_metres(tmp_path: Path, camera: str) -> None:
    depths = [depth.astype(np.float32) for depth in slopes()]
    sequence = open_sequence(recording(tmp_path, depths, camera))
    frame = sequence.read(1)
    assert isinstance(frame, RgbdFrame)
    np.testing.assert_allclose(frame.depth.numpy(), depths[1], rtol=1e-6)
    assert len(sequence.warnings) == (1 if "000" in camera else 0)
    assert "depth in metres" in sequence.recognised


def test_floats_in_millimetres_are_read_as_the_file_says_and_doubted_where_none_does(tmp_path: Path) -> None:
    depths = [(1000 * depth).astype(np.float32) for depth in slopes()]
    sequence = open_sequence(recording(tmp_path / "a", depths, "depth_scale = 1000\n"))
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert (float(frame.depth[0, 0]), sequence.warnings) == (1.0, [])
    (warning,) = open_sequence(recording(tmp_path / "b", depths)).warnings
    assert "the raw median 2000 is 2 m with 1000 (millimetres)" in warning
    assert open_sequence(tmp_path / "b", depth_scale=1000).warnings == []


def test_what_the_user_passes_counts_for_floats_too(tmp_path: Path) -> None:
    depths = [depth.astype(np.float32) for depth in slopes()]
    frame = open_sequence(recording(tmp_path, depths), depth_scale=2.0).read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth[0, 0]) == 0.5


@pytest.mark.parametrize(
    ("filled", "kind"),
    [(10000, np.uint16), (8191, np.uint16), (65504.0, np.float32), (1e10, np.float32), (40.0, np.float32)],
)
def test_holes_filled_with_a_far_constant_are_unknown(tmp_path: Path, filled: float, kind: type) -> None:
    factor = 1000 if kind is np.uint16 else 1
    depths = [(factor * depth).astype(kind) for depth in slopes(5)]
    for depth in depths:
        depth[:9, 20:40] = filled
    sequence = open_sequence(recording(tmp_path, depths))
    (warning,) = sequence.warnings
    assert f"depth of exactly {filled:g} stands alone" in warning
    for frame in sequence:
        assert isinstance(frame, RgbdFrame)
        assert float(frame.depth[:9, 20:40].max()) == 0
        assert bool((frame.depth[9:] > 0).all())


def test_what_was_measured_is_not_taken_for_holes(tmp_path: Path) -> None:
    """A wall of one depth: alone, behind a floor that leads to it, coming nearer, seen by a camera that is still."""
    wall = [np.full((48, 64), 1500, np.uint16) for _ in range(3)]
    floor = [np.minimum(1000 * depth, 2500).astype(np.uint16) for depth in slopes()]
    nearer = [np.where(np.indices((48, 64))[1] < 30, 3000 - 50 * n, 1200 - 10 * n).astype(np.uint16) for n in range(3)]
    still = [np.where(np.indices((48, 64))[1] < 30, 3000, 1200).astype(np.uint16)] * 3
    for name, depths in (("wall", wall), ("floor", floor), ("nearer", nearer), ("still", still)):
        sequence = open_sequence(recording(tmp_path / name, depths))
        assert sequence.warnings == []
        frame = sequence.read(0)
        assert isinstance(frame, RgbdFrame)
        assert bool((frame.depth > 0).all())


class Stored(Recording):
    """A film as it is stored, with so many depth values per metre."""

    depth_scale = 1000.0


@pytest.mark.parametrize(
    ("factor", "scale", "verdict"),
    [(0.15, 1.0, Verdict.GOOD), (0.15, 1000.0, Verdict.NOTE), (0.2, 5000.0, Verdict.FAULT), (5, 1000.0, Verdict.FAULT)],
)
def test_check_calls_no_close_range_scan_a_fault(desk: Film, factor: float, scale: float, verdict: Verdict) -> None:
    frames = [RgbdFrame(f.timestamp, f.gray, f.depth * factor, f.camera, f.color) for f in desk.frames[:3]]
    film = Stored(frames)
    film.depth_scale = scale
    (row,) = (finding for finding in check(film).findings if finding.name == "depth scale")
    assert row.verdict is verdict
    assert bool(row.advice) == (verdict is not Verdict.GOOD)
    assert torch.isfinite(frames[0].depth).all()


@pytest.mark.parametrize("name", ["iphone_door_40", "azure_arm_61"])
def test_real_close_range_scans_have_no_fault_of_scale(data_dir: Path, name: str) -> None:
    sequence = open_sequence(data_dir / name, every=20)
    (row,) = (finding for finding in check(sequence).findings if finding.name == "depth scale")
    assert row.verdict is not Verdict.FAULT
