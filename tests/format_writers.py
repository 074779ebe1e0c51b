"""Writes a rendered film in each format, as the format's documentation says; for the tests of the loaders.

Each function fills a folder and returns the files of a frame by its number, colour first.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered import Film

from idrgbdo_torch.trajectory import quaternion_from_rotation, write_tum

Files = Callable[[int], tuple[Path, Path]]
FPS = 30
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def color(film: Film, index: int) -> NDArray[np.uint8]:
    """(H, W, 3) blue, green, red."""
    image = film.frames[index].color
    assert image is not None
    return np.ascontiguousarray(image.numpy()[..., ::-1])


def depth(film: Film, index: int, scale: float) -> NDArray[np.uint16]:
    """(H, W) with `scale` values per metre."""
    return np.round(film.frames[index].depth.numpy().astype(np.float64) * scale).astype(np.uint16)


def pose(film: Film, index: int) -> NDArray[np.float64]:
    """(4, 4) T_world_cam."""
    return film.groundtruth.T_world_cam[index].numpy()


def save(path: Path, image: NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def matrix(T: NDArray[np.float64], separator: str = "\n") -> str:
    return separator.join(" ".join(f"{value:.10e}" for value in row) for row in T)


def camera_toml(film: Film, folder: Path, extra: str = "") -> None:
    c = film.frames[0].camera
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "camera.toml").write_text(f"fx = {c.fx}\nfy = {c.fy}\ncx = {c.cx}\ncy = {c.cy}\n{extra}")


def tum(film: Film, folder: Path) -> Files:
    """TUM RGB-D with the calibration.txt of ETH3D SLAM."""
    lists: dict[str, list[str]] = {"rgb": [], "depth": []}
    for index, frame in enumerate(film.frames):
        stamp = f"{frame.timestamp:.6f}"
        for kind, image in (("rgb", color(film, index)), ("depth", depth(film, index, 5000))):
            save(folder / kind / f"{stamp}.png", image)
            lists[kind].append(f"{stamp} {kind}/{stamp}.png")
    for kind, lines in lists.items():
        (folder / f"{kind}.txt").write_text("# timestamp filename\n" + "\n".join(lines))
    c = film.frames[0].camera
    (folder / "calibration.txt").write_text(f"{c.fx} {c.fy} {c.cx} {c.cy}")
    write_tum(folder / "groundtruth.txt", film.groundtruth)

    def files(index: int) -> tuple[Path, Path]:
        name = f"{film.frames[index].timestamp:.6f}.png"
        return folder / "rgb" / name, folder / "depth" / name

    return files


def icl_png(film: Film, folder: Path) -> Files:
    """ICL-NUIM, "TUM RGB-D compatible PNGs": frame numbers for times, y axis up in the poses."""
    camera_toml(film, folder)
    pairs, poses = [], []
    for index in range(len(film.frames)):
        save(folder / "rgb" / f"{index}.png", color(film, index))
        save(folder / "depth" / f"{index}.png", depth(film, index, 5000))
        pairs.append(f"{index} depth/{index}.png {index} rgb/{index}.png")
        T = MIRROR @ pose(film, index) @ MIRROR
        import torch

        q = quaternion_from_rotation(torch.from_numpy(np.ascontiguousarray(T[:3, :3]))).tolist()
        poses.append(" ".join([str(index), *(f"{value:.9f}" for value in [*T[:3, 3], *q])]))
    (folder / "associations.txt").write_text("\n".join(pairs))
    (folder / "livingRoom9.gt.freiburg").write_text("\n".join(poses[1:]))  # the published ones begin with 1
    return lambda index: (folder / "rgb" / f"{index}.png", folder / "depth" / f"{index}.png")


def icl_povray(film: Film, folder: Path) -> Files:
    """ICL-NUIM, POV-Ray's files: depth along the ray in centimetres, position and axes of the camera, y up."""
    camera_toml(film, folder)
    c = film.frames[0].camera
    v, u = np.indices((c.height, c.width))
    ray = np.sqrt(((u - c.cx) / c.fx) ** 2 + ((v - c.cy) / -c.fy) ** 2 + 1)
    for index, frame in enumerate(film.frames):
        name = folder / f"scene_00_{index:04}"
        save(name.with_suffix(".png"), color(film, index))
        along = frame.depth.numpy().astype(np.float64) * ray * 100
        name.with_suffix(".depth").write_text(" ".join(f"{value:.4f}" for value in along.ravel()))
        T = MIRROR @ pose(film, index) @ MIRROR
        vectors = {"cam_pos": T[:3, 3] * 100, "cam_dir": T[:3, 2], "cam_up": T[:3, 1] + 0.3 * T[:3, 2]}
        lines = [f"{key} = [{', '.join(f'{x:.10f}' for x in value)}]';" for key, value in vectors.items()]
        name.with_suffix(".txt").write_text("\n".join([*lines, "cam_lookat = [0, 0, 1]';", "cam_angle = 90;"]))
    return lambda index: (folder / f"scene_00_{index:04}.png", folder / f"scene_00_{index:04}.depth")


def redwood(film: Film, folder: Path) -> Files:
    """Open3D/Redwood: JPEG colour, millimetres, intrinsics column by column, trajectory.log."""
    log = []
    for index in range(len(film.frames)):
        save(folder / "color" / f"{index:06}.jpg", color(film, index))
        save(folder / "depth" / f"{index:06}.png", depth(film, index, 1000))
        log.append(f"{index} {index} {index + 1}\n{matrix(pose(film, index))}")
    (folder / "trajectory.log").write_text("\n".join(log) + "\n")
    c = film.frames[0].camera
    intrinsics = {
        "width": c.width,
        "height": c.height,
        "intrinsic_matrix": [c.fx, 0, 0, 0, c.fy, 0, c.cx, c.cy, 1],
    }
    (folder / "camera_intrinsic.json").write_text(json.dumps(intrinsics, indent=4))
    return lambda index: (folder / "color" / f"{index:06}.jpg", folder / "depth" / f"{index:06}.png")


def replica(film: Film, folder: Path) -> Files:
    """Replica as NICE-SLAM lays it out: a pose a line, the camera one folder up."""
    results = folder / "results"
    for index in range(len(film.frames)):
        save(results / f"frame{index:06}.jpg", color(film, index))
        save(results / f"depth{index:06}.png", depth(film, index, 6553.5))
    (folder / "traj.txt").write_text("\n".join(matrix(pose(film, i), " ") for i in range(len(film.frames))) + "\n")
    c = film.frames[0].camera
    numbers = {"w": c.width, "h": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "scale": 6553.5}
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": numbers}))
    return lambda index: (results / f"frame{index:06}.jpg", results / f"depth{index:06}.png")


def scannet(film: Film, folder: Path) -> Files:
    """ScanNet, extracted: colour of twice the size, depth of another focal length, a pose file a frame."""
    c = film.frames[0].camera
    fd = c.fx * 0.98
    K_color = np.diag([1.0, 1.0, 1.0, 1.0])
    K_color[:2, :3] = [[2 * c.fx, 0, 2 * c.cx + 0.5], [0, 2 * c.fy, 2 * c.cy + 0.5]]
    K_depth = np.diag([1.0, 1.0, 1.0, 1.0])
    K_depth[:2, :3] = [[fd, 0, c.cx], [0, fd, c.cy]]
    v, u = np.indices((c.height, c.width)).astype(np.float32)
    map_u, map_v = ((u - c.cx) / fd * c.fx + c.cx), ((v - c.cy) / fd * c.fy + c.cy)
    for name, K in (("color", K_color), ("depth", K_depth)):
        (folder / "intrinsic").mkdir(parents=True, exist_ok=True)
        (folder / "intrinsic" / f"intrinsic_{name}.txt").write_text(matrix(K))
        (folder / "intrinsic" / f"extrinsic_{name}.txt").write_text(matrix(np.eye(4)))
    (folder / "pose").mkdir()
    for index in range(len(film.frames)):
        large = cv2.resize(color(film, index), (2 * c.width, 2 * c.height), interpolation=cv2.INTER_NEAREST)
        save(folder / "color" / f"{index}.jpg", large)
        save(folder / "depth" / f"{index}.png", cv2.remap(depth(film, index, 1000), map_u, map_v, cv2.INTER_NEAREST))
        T = np.full((4, 4), -np.inf) if index == 5 else pose(film, index)  # a frame that the reference lost
        (folder / "pose" / f"{index}.txt").write_text(matrix(T))
    return lambda index: (folder / "color" / f"{index}.jpg", folder / "depth" / f"{index}.png")


def own_folder(film: Film, folder: Path) -> Files:
    """Anybody's folder: color/ and depth/, numbers for names, millimetres, camera.toml."""
    camera_toml(film, folder, "fps = 30\n")
    for index in range(len(film.frames)):
        save(folder / "color" / f"{index:06}.png", color(film, index))
        save(folder / "depth" / f"{index:06}.png", depth(film, index, 1000))
    times = film.groundtruth.timestamps.clone()
    lines = [f"{k / FPS:.6f} {' '.join(f'{x:.9f}' for x in row)}" for k, row in enumerate(_tum_rows(film))]
    assert len(lines) == len(times)
    (folder / "groundtruth.txt").write_text("\n".join(lines))
    return lambda index: (folder / "color" / f"{index:06}.png", folder / "depth" / f"{index:06}.png")


def seven_scenes(
    film: Film, folder: Path, depths: list[NDArray[np.uint16]], T_color_depth: NDArray[np.float64]
) -> Files:
    """7-Scenes: depth images of the depth camera (millimetres, 65535 where unknown), whose poses these are."""
    for index, image in enumerate(depths):
        save(folder / f"frame-{index:06}.color.png", color(film, index))
        save(folder / f"frame-{index:06}.depth.png", np.where(image > 0, image, 65535).astype(np.uint16))
        T = pose(film, index) @ T_color_depth
        (folder / f"frame-{index:06}.pose.txt").write_text(matrix(T))
    return lambda index: (folder / f"frame-{index:06}.color.png", folder / f"frame-{index:06}.depth.png")


def _tum_rows(film: Film) -> list[list[float]]:
    """tx ty tz qx qy qz qw of each frame."""
    T = film.groundtruth.T_world_cam
    quaternions = quaternion_from_rotation(T[:, :3, :3]).tolist()
    return [[*p, *q] for p, q in zip(T[:, :3, 3].tolist(), quaternions, strict=True)]
