"""Small recordings of every format as bytes, ready to be spoiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bag_writer
import cv2
import format_writers
import mcap_writer
import numpy as np
import torch
from rendered import Film
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.trajectory import Trajectory

FRAMES, WIDTH, HEIGHT = 6, 64, 48
Files = dict[str, bytes]  # by their path in the recording's folder
IMAGES = (".png", ".jpg", ".depth", ".npy", ".npz", ".exr", ".tiff", ".pfm", ".webp", ".jp2", ".bmp", ".avif", ".gif")


@cache
def film() -> Film:
    """A textured wall that is slanted, and a camera that moves along it."""
    rng = np.random.default_rng(0)
    camera = Pinhole(width=WIDTH, height=HEIGHT, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH + FRAMES, 3), np.uint8), (3, 3), 1)
    depth = torch.linspace(1.0, 2.0, WIDTH).expand(HEIGHT, WIDTH).contiguous()
    frames = []
    for k in range(FRAMES):
        color = torch.from_numpy(np.ascontiguousarray(wall[:, k : k + WIDTH]))
        frames.append(RgbdFrame(100 + k / 30, color[..., 0].float(), depth, camera, color))
    T_world_cam = torch.eye(4, dtype=torch.float64).repeat(FRAMES, 1, 1)
    T_world_cam[:, 0, 3] = torch.arange(FRAMES) * 0.03
    return Film(tuple(frames), Trajectory(torch.tensor([f.timestamp for f in frames]).double(), T_world_cam))


def arrays(made: Film, folder: Path) -> None:
    """Colour and depth as each of the kinds of files that are no usual PNG or JPEG."""
    colors, depths = (
        (".webp", ".jp2", ".bmp", ".avif", ".tiff", ".gif"),
        (".npy", ".npz", ".exr", ".tiff", ".pfm", ".npy"),
    )
    format_writers.camera_toml(made, folder, "fps = 30\ndepth_scale = 1.0\n")
    for k, (of_color, of_depth) in enumerate(zip(colors, depths, strict=True)):
        format_writers.save(folder / "rgb" / f"{k}{of_color}", format_writers.color(made, k))
        metres = made.frames[k].depth.numpy()
        path = folder / "depth" / f"{k}{of_depth}"
        path.parent.mkdir(exist_ok=True)
        if of_depth == ".npz":
            np.savez_compressed(path, depth=metres)
        elif of_depth == ".npy":
            np.save(path, metres)
        elif of_depth == ".exr":
            import OpenEXR

            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {"Z": metres}).write(str(path))
        else:
            format_writers.save(path, metres)


def seven_scenes(made: Film, folder: Path) -> None:
    format_writers.camera_toml(made, folder)
    depths = [format_writers.depth(made, k, 1000) for k in range(FRAMES)]
    format_writers.seven_scenes(made, folder, depths, np.eye(4))


def associated(made: Film, folder: Path) -> None:
    """TUM with a list of pairs instead of two lists, ground truth and a calibration of OpenCV's."""
    format_writers.tum(made, folder)
    names = [f"{frame.timestamp:.6f}" for frame in made.frames]
    (folder / "associations.txt").write_text("".join(f"{n} rgb/{n}.png {n} depth/{n}.png\n" for n in names))
    for name in ("rgb.txt", "depth.txt", "calibration.txt"):
        (folder / name).unlink()
    storage = cv2.FileStorage(str(folder / "camera.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", made.frames[0].camera.matrix().numpy())
    storage.write("dist_coeffs", np.array([[0.01, -0.02, 0.001, 0.002, 0.005]]))
    storage.release()


WRITERS: dict[str, Callable[[Film, Path], object]] = {
    "tum": format_writers.tum,
    "associated": associated,
    "icl_png": format_writers.icl_png,
    "icl_povray": format_writers.icl_povray,
    "redwood": format_writers.redwood,
    "replica": format_writers.replica,
    "scannet": format_writers.scannet,
    "7scenes": seven_scenes,
    "folder": format_writers.own_folder,
    "arrays": arrays,
}
BAGS = (
    *("ros1", "ros1 compressed images", "ros1 bz2", "ros1 lz4", "mcap", "mcap compressed images", "mcap messages"),
    *("mcap file", "mcap recorder", "mcap recorder zstd", "mcap recorder lz4", "mcap recorder no chunks", "sqlite3"),
)


@cache
def folder_of(kind: str) -> Files:
    """A recording of one of WRITERS."""
    with TemporaryDirectory() as parent:
        WRITERS[kind](film(), Path(parent) / "made")
        return _files(Path(parent))


@cache
def bag_of(kind: str) -> Files:
    """A recording of one of BAGS: one file, or a folder with metadata.yaml."""
    version = 1 if kind.startswith("ros1") else 2
    plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    if "recorder" in kind:
        packing = "" if kind.endswith(("recorder", "chunks")) else kind.split()[-1]
        made = mcap_writer.write_mcap(mcap_writer.messages(film()), packing, 0 if kind.endswith("chunks") else 3)
        return {"made.mcap": made}
    packed = {}
    if "compressed" in kind:
        topics = ("/camera/color/image_raw/compressed", "/camera/depth/image_raw/compressedDepth")
        packed = {"color": bag_writer.png, "depth": bag_writer.compressed_depth, "topics": topics}

    def prepare(writer: Any) -> None:
        last = kind.split()[-1]
        if version == 1:
            writer.chunk_threshold = 20_000
        if last in ("bz2", "lz4"):
            writer.set_compression(writer.CompressionFormat[last.upper()])
        if last in ("messages", "file"):
            mode = CompressionMode.FILE if last == "file" else CompressionMode.MESSAGE
            writer.set_compression(mode, CompressionFormat.ZSTD)

    with TemporaryDirectory() as parent:
        path = Path(parent) / ("made.bag" if version == 1 else "made")
        bag_writer.write_bag(film(), path, version, plugin, prepare=prepare, **packed)
        return _files(Path(parent))


def _files(parent: Path) -> Files:
    return {str(path.relative_to(parent)): path.read_bytes() for path in sorted(parent.rglob("*")) if path.is_file()}


def write(files: Files, parent: Path) -> Path:
    """Write them below `parent`; what is to be opened."""
    for name, data in files.items():
        path = parent / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return parent / next((name for name in ("made.bag", "made.mcap") if name in files), "made")


def is_image(name: str) -> bool:
    """Whether a file of a recording is an image of one frame."""
    return name.endswith(IMAGES)
