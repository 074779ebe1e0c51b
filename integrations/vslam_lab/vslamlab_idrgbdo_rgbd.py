"""One run for VSLAM-LAB, mode rgbd: its arguments and files in, its trajectory out. See docs/vslam-lab.md.

python vslamlab_idrgbdo_rgbd.py --sequence_path DIR --calibration_yaml FILE --rgb_csv FILE --exp_folder DIR
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import yaml

from idrgbdo_torch import IdRgbdo, open_sequence, run
from idrgbdo_torch.config import Config, settings_file
from idrgbdo_torch.text import configfile
from idrgbdo_torch.trajectory import quaternion_from_rotation

NANOSECONDS = 1e9
HEADER = ("ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw")
DISTORTION = {"radtan4": ("k1", "k2", "p1", "p2"), "radtan5": ("k1", "k2", "p1", "p2", "k3")}


def camera_of(calibration: Path, name: str) -> dict[str, Any]:
    """The entry of a camera in calibration.yaml."""
    cameras = yaml.safe_load(calibration.read_text(encoding="utf-8"))["cameras"]
    return next(camera for camera in cameras if camera["cam_name"] == name)


def camera_toml(camera: dict[str, Any]) -> str:
    """The same as a camera.toml of ours."""
    (fx, fy), (cx, cy), (width, height) = (
        camera[key] for key in ("focal_length", "principal_point", "image_dimension")
    )
    values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height}
    names = DISTORTION.get(camera.get("distortion_type", ""), ())
    values |= dict(zip(names, camera.get("distortion_coefficients", ()), strict=False))
    return "".join(f"{name} = {value}\n" for name, value in values.items())


def main() -> None:
    """Track every frame of rgb_csv; a lost frame has no line in the trajectory."""
    parser = argparse.ArgumentParser()
    for name in ("sequence_path", "calibration_yaml", "rgb_csv", "exp_folder"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--exp_it", default="0")
    parser.add_argument("--settings_yaml", type=Path)
    arguments, _ = parser.parse_known_args()  # it passes more, such as --verbose
    settings = yaml.safe_load(arguments.settings_yaml.read_text(encoding="utf-8")) if arguments.settings_yaml else {}
    name = settings.get("cam_mono", "rgb_0")
    camera = camera_of(arguments.calibration_yaml, name)
    depth = camera["depth_name"]
    with arguments.rgb_csv.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    times = [int(row[f"ts_{name} (ns)"]) for row in rows]
    begin = times[0]  # seconds since then keep every nanosecond
    prefix = arguments.exp_it.zfill(5)
    pairs, camera_file = (arguments.exp_folder / f"{prefix}_{end}" for end in ("pairs.txt", "camera.toml"))
    root = arguments.sequence_path.resolve()
    lines = []
    for time, row in zip(times, rows, strict=True):
        seconds = f"{(time - begin) / NANOSECONDS:.9f}"
        lines.append(f"{seconds} {root / row[f'path_{name}']} {seconds} {root / row[f'path_{depth}']}\n")
    pairs.write_text("".join(lines), encoding="utf-8")
    camera_file.write_text(camera_toml(camera), encoding="utf-8")
    preset = settings.get("config")
    config = configfile.load(settings_file(Path(preset)), Config()) if preset else Config()
    scale = float(camera["depth_factor"])
    sequence = open_sequence(root, format="tum", camera=camera_file, associations=pairs, depth_scale=scale)
    done = run(IdRgbdo(config), sequence)
    path = arguments.exp_folder / f"{prefix}_KeyFrameTrajectory.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for record in done.records:
            if record.result.status.value != "lost":
                T = record.result.T_world_cam
                pose = T[:3, 3].tolist() + quaternion_from_rotation(T[:3, :3]).tolist()
                writer.writerow([begin + round(record.timestamp * NANOSECONDS), *pose])


if __name__ == "__main__":
    main()
