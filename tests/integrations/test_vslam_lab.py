"""The adapter for VSLAM-LAB, on a rendered sequence in its layout."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import idrgbdo_torch
from idrgbdo_torch import IdRgbdo, RgbdFrame, run
from idrgbdo_torch.synthetic import RenderedSequence, SynthConfig
from idrgbdo_torch.trajectory import rotation_from_quaternion

SCRIPT = Path(__file__).parent.parent.parent / "integrations" / "vslam_lab" / "vslamlab_idrgbdo_rgbd.py"
BEGIN = 1_700_000_000_123_456_789  # ns
STEP = 33_333_333
CAMERA = {"width": 320, "height": 240, "fx": 262.5, "fy": 262.5, "cx": 159.5, "cy": 119.5}


def test_a_sequence_of_vslam_lab_gives_the_trajectory_of_its_frames(tmp_path: Path) -> None:
    pytest.importorskip("yaml")
    sequence = RenderedSequence(SynthConfig(frames=8, samples=1, **CAMERA))
    rows, frames = [], []
    for kind in ("rgb_0", "depth_0", "exp"):
        (tmp_path / kind).mkdir()
    for number in range(len(sequence)):
        frame = sequence.read(number)
        assert frame.color is not None
        steps = (5000 * frame.depth.numpy()).round().astype(np.uint16)
        names = [f"{kind}/{number:05}.png" for kind in ("rgb_0", "depth_0")]
        cv2.imwrite(str(tmp_path / names[0]), np.ascontiguousarray(frame.color.numpy()[..., ::-1]))
        cv2.imwrite(str(tmp_path / names[1]), steps)
        time = BEGIN + number * STEP
        rows.append([time, names[0], time, names[1]])
        seconds = round((time - BEGIN) / 1e9, 9)
        frames.append(RgbdFrame.from_images(seconds, frame.color, steps, frame.camera, depth_scale=5000))
    with (tmp_path / "rgb_exp.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["ts_rgb_0 (ns)", "path_rgb_0", "ts_depth_0 (ns)", "path_depth_0"], *rows])
    (tmp_path / "calibration.yaml").write_text(
        "cameras:\n- {cam_name: rgb_0, cam_type: rgb+depth, depth_name: depth_0, depth_factor: 5000.0,"
        " cam_model: pinhole, focal_length: [262.5, 262.5], principal_point: [159.5, 119.5],"
        " image_dimension: [320, 240], fps: 30.0}\n"
    )
    arguments = {"sequence_path": tmp_path, "calibration_yaml": tmp_path / "calibration.yaml", "exp_it": "3"}
    arguments |= {"rgb_csv": tmp_path / "rgb_exp.csv", "exp_folder": tmp_path / "exp", "verbose": "1", "mode": "rgbd"}
    arguments["settings_yaml"] = SCRIPT.parent / "vslamlab_idrgbdo_settings.yaml"
    words = [str(word) for name, value in arguments.items() for word in (f"--{name}", value)]
    subprocess.run(
        [sys.executable, str(SCRIPT), *words], cwd=SCRIPT.parent.parent.parent, env=_environment(), check=True
    )
    with (tmp_path / "exp" / "00003_KeyFrameTrajectory.csv").open() as file:
        header, *lines = list(csv.reader(file))
    assert header == ["ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw"]
    assert [int(line[0]) for line in lines] == [BEGIN + number * STEP for number in range(len(frames))]
    poses = torch.tensor([[float(cell) for cell in line[1:]] for line in lines], dtype=torch.float64)
    expected = run(IdRgbdo(), frames).trajectory()
    torch.testing.assert_close(poses[:, :3], expected.positions, atol=1e-6, rtol=0)
    torch.testing.assert_close(
        rotation_from_quaternion(poses[:, 3:]), expected.T_world_cam[:, :3, :3], atol=1e-6, rtol=0
    )


def _environment() -> dict[str, str]:
    """So that a script of another folder finds this package where it is not installed."""
    return {**os.environ, "PYTHONPATH": str(Path(idrgbdo_torch.__file__).parent.parent)}
