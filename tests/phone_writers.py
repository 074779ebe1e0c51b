"""Writes a film as the phone apps Record3D and Stray Scanner do, for the tests of their loaders.

A film is RgbdFrames whose depth is reduced to a phone's 256x192 (192x256 where it is held upright).
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import av
import cv2
import format_writers
import lzfse
import numpy as np
import OpenEXR
import torch
from numpy.typing import NDArray
from rendered import Film

from idrgbdo_torch.trajectory import quaternion_from_rotation

FPS = 30
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
LOW = 40.0  # m, in the corner that has low confidence


def coarse_depth(film: Film, index: int) -> NDArray[np.float32]:
    """(rows, columns) metres of a phone's LiDAR: the nearest pixel at the centre of each of its own; 0.8 of 320x240."""
    depth = film.frames[index].depth.numpy()
    rows, columns = (192, 256) if depth.shape[0] < depth.shape[1] else (256, 192)
    v, u = ((np.arange(n) + 0.5) * size / n - 0.5 for n, size in zip((rows, columns), depth.shape, strict=True))
    return np.ascontiguousarray(depth[np.ix_(np.rint(v).astype(int), np.rint(u).astype(int))], np.float32)


def doubtful(depth: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The depth with nonsense in its corner, and the confidence that says so."""
    wrong, confidence = depth.copy(), np.full(depth.shape, 2, np.uint8)
    wrong[:40, :40], confidence[:40, :40] = LOW, 0
    return wrong, confidence


def quaternions(film: Film, axes: NDArray[np.float64]) -> list[list[float]]:
    """x, y, z, w of each camera, its axes turned."""
    poses = [format_writers.pose(film, index)[:3, :3] @ axes[:3, :3] for index in range(len(film.frames))]
    return quaternion_from_rotation(torch.from_numpy(np.stack(poses))).tolist()


def metadata(film: Film, **more: object) -> dict[str, object]:
    """Record3D's, of the film's cameras."""
    c = film.frames[0].camera
    rows, columns = coarse_depth(film, 0).shape
    positions = film.groundtruth.positions.tolist()
    poses = [[*q, *p] for q, p in zip(quaternions(film, OPENGL), positions, strict=True)]
    K = [c.fx, 0, 0, 0, c.fy, 0, c.cx, c.cy, 1]
    sizes = {"w": c.width, "h": c.height, "dw": columns, "dh": rows}
    return {"K": K, "fps": FPS, **sizes, "poses": poses, "initPose": poses[0], **more}


def jpeg(film: Film, index: int) -> bytes:
    done, data = cv2.imencode(".jpg", format_writers.color(film, index), [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert done
    return bytes(data)


def record3d_parts(film: Film, **more: object) -> dict[str, bytes]:
    """The files inside an .r3d, by name."""
    parts = {"metadata": json.dumps(metadata(film, **more)).encode(), "icon": b"icon"}
    for index in range(len(film.frames)):
        depth, confidence = doubtful(coarse_depth(film, index))
        parts[f"rgbd/{index}.jpg"] = jpeg(film, index)
        parts[f"rgbd/{index}.depth"] = lzfse.compress(depth.tobytes())
        parts[f"rgbd/{index}.conf"] = lzfse.compress(confidence.tobytes())
    return parts


def r3d(film: Film, path: Path, **more: object) -> Path:
    """An .r3d file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in record3d_parts(film, **more).items():
            archive.writestr(name, data)
    return path


def r3d_unpacked(film: Film, folder: Path) -> format_writers.Files:
    """The same, unpacked."""
    for name, data in record3d_parts(film).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return lambda index: (folder / "rgbd" / f"{index}.jpg", folder / "rgbd" / f"{index}.depth")


def record3d_exr(film: Film, folder: Path, **more: object) -> format_writers.Files:
    """Record3D's export as colour and EXR depth."""
    for kind in ("rgb", "depth"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    (folder / "metadata.json").write_text(json.dumps(metadata(film, **more)))
    for index in range(len(film.frames)):
        (folder / "rgb" / f"{index}.jpg").write_bytes(jpeg(film, index))
        write_exr(folder / "depth" / f"{index}.exr", coarse_depth(film, index))
    return lambda index: (folder / "rgb" / f"{index}.jpg", folder / "depth" / f"{index}.exr")


def write_exr(path: Path, depth: NDArray[np.float32]) -> None:
    """Metres in the channel R."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"R": np.ascontiguousarray(depth, np.float32)}).write(str(path))


def write_video(path: Path, images: Sequence[NDArray[np.uint8]], codec: str = "libx265", turned: bool = False) -> None:
    """Blue, green, red images as a video. turned: marked as to be shown a quarter turn clockwise."""
    height, width = images[0].shape[:2]
    with av.open(str(path), "w") as container:
        options = {"crf": "8", "preset": "veryfast"} | (
            {"x265-params": "log-level=error"} if codec == "libx265" else {}
        )
        stream = container.add_stream(codec, rate=FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    if turned:
        turn(path)


def turn(path: Path) -> None:
    """Write a quarter turn into the track header, as phones that are held upright do."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # version 0: the matrix stands behind ten numbers of 4 bytes
    one = 1 << 16
    for place, value in enumerate((0, one, 0, -one, 0, 0, 0, 0, 1 << 30)):
        data[at + 4 * place : at + 4 * place + 4] = value.to_bytes(4, "big", signed=True)
    path.write_bytes(bytes(data))


def stray(
    film: Film, folder: Path, turned: bool = False, lenses: Sequence[Sequence[float]] = ()
) -> format_writers.Files:
    """A folder of Stray Scanner. lenses: fx, fy, cx, cy of each frame, for the app's newest version."""
    frames = range(len(film.frames))
    folder.mkdir(parents=True, exist_ok=True)
    write_video(folder / "rgb.mp4", [format_writers.color(film, index) for index in frames], turned=turned)
    c = film.frames[0].camera
    (folder / "camera_matrix.csv").write_text(f"{c.fx}, 0.0, {c.cx}\n0.0, {c.fy}, {c.cy}\n0.0, 0.0, 1.0\n")
    names = ["timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw", *(("fx", "fy", "cx", "cy") if lenses else ())]
    lines = [", ".join(names)]
    positions, turns = film.groundtruth.positions.tolist(), quaternions(film, np.eye(4))
    for index in frames:
        depth, confidence = doubtful(coarse_depth(film, index))
        name = f"{index:06}.png"
        format_writers.save(folder / "depth" / name, np.round(depth * 1000).astype(np.uint16))
        format_writers.save(folder / "confidence" / name, confidence)
        numbers = [*positions[index], *turns[index], *(lenses[index] if lenses else ())]
        lines.append(f"{5000 + index / FPS}, {index:06}, " + ", ".join(f"{x:.9f}" for x in numbers))
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    return lambda index: (folder / "confidence" / f"{index:06}.png", folder / "depth" / f"{index:06}.png")
