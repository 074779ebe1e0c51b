"""One bad file costs one frame, or one sentence: any image, the first one too, any list, calibration or pose file."""

from __future__ import annotations

import os
import shutil
import struct
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bag_writer
import cv2
import numpy as np
import pytest
from bag_writer import write_bag
from fuzz import recorded
from fuzz.hostile import packed
from fuzz.promise import limits
from png_writer import GRAY, RGB, SIGNATURE, chunk, header
from recordings import write_recording
from rendered import Film
from rosbags.rosbag2 import StoragePlugin

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.image_size import declared_size
from idrgbdo_torch.datasets.images import decode_color, read_depth
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame

Harm = Callable[[Path], object]


def enormous_png(bits: int, kind: int, side: int = 60_000) -> bytes:
    return SIGNATURE + header(side, side, bits, kind) + chunk(b"IDAT", b"x\x9c\x03\0\0\0\0\1") + chunk(b"IEND")


def array(path: Path, shape: tuple[int, ...], kind: str = "<f4", data: bytes = bytes(99)) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
        file.write(data)


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def link(path: Path, target: str) -> None:
    path.unlink()
    path.symlink_to(target)


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


IMAGES: dict[str, Harm] = {
    "60000x60000": lambda path: path.write_bytes(
        enormous_png(8, RGB) if "rgb" in str(path) else enormous_png(16, GRAY)
    ),
    "30000x30000": lambda path: path.write_bytes(enormous_png(8, RGB, 30_000)),
    "a size that OpenCV refuses": lambda path: path.write_bytes(b"P5\n999999 999999\n65535\n" + bytes(99)),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-40]),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("not found"),
    "a pipe": fifo,
    "a device": partial(link, target="/dev/zero"),
    "a link to nothing": partial(link, target="gone"),
    "a link to itself": lambda path: link(path, path.name),
    "a folder": folder,
    "another size": lambda path: cv2.imwrite(str(path), np.ones((24, 32), np.uint16)),
    "one pixel": lambda path: cv2.imwrite(str(path), np.ones((1, 1), np.uint16)),
}


@pytest.mark.parametrize("number", [0, 3])
@pytest.mark.parametrize("kind", ["rgb", "depth"])
@pytest.mark.parametrize("harm", IMAGES)
def test_an_image_that_cannot_be_read_costs_its_frame(harm: str, kind: str, number: int, tmp_path: Path) -> None:
    recording = write_recording(tmp_path, frames=6)
    IMAGES[harm](sorted((recording / kind).iterdir())[number])
    with limits(10):
        sequence = open_sequence(recording)
        found = list(sequence)
    assert [number for number, frame in enumerate(found) if isinstance(frame, BrokenFrame)] == [number]
    broken = found[number]
    assert isinstance(broken, BrokenFrame) and "\n" not in broken.reason and len(broken.reason) > 20
    assert (sequence.camera.width, sequence.camera.height) == (64, 48)


ARRAYS: dict[str, Harm] = {
    "an archive": lambda path: path.write_bytes(b"PK\x05\x06" + bytes(18)),
    "an archive of an enormous one": lambda path: path.write_bytes(packed(b"\x93NUMPY" + bytes(600 << 20))),
    "a number": lambda path: np.save(path, np.float32(1.5)),
    "an enormous shape": lambda path: array(path, (1 << 62, 1 << 62)),
    "16 GB": lambda path: array(path, (65_000, 65_000)),
    "a negative shape": lambda path: array(path, (-1, 64)),
    "no pixel": lambda path: np.save(path, np.zeros((0, 64), np.float32)),
    "objects": lambda path: array(path, (2,), "|O"),
    "texts": lambda path: np.save(path, np.full((48, 64), "ab")),
    "whole numbers": lambda path: np.save(path, np.full((48, 64), 1500, np.uint16)),
    "a header without end": lambda path: path.write_bytes(b"\x93NUMPY\x02\0\xff\xff\xff\xff{"),
}


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("harm", ARRAYS)
def test_an_array_that_is_no_depth_costs_its_frame(harm: str, number: int, tmp_path: Path) -> None:
    recording = write_recording(tmp_path, frames=4)
    for kind in ("rgb.txt", "depth.txt", "calibration.txt", "groundtruth.txt"):
        (recording / kind).unlink()
    shutil.rmtree(recording / "depth")
    (recording / "depth").mkdir()
    names = [path.stem for path in sorted((recording / "rgb").iterdir())]
    for name in names:
        np.save(recording / "depth" / f"{name}.npy", np.full((48, 64), 1.5, np.float32))
    (recording / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n")
    ARRAYS[harm](recording / "depth" / f"{names[number]}.npy")
    with limits(10):
        found = list(open_sequence(recording))
    assert [k for k, frame in enumerate(found) if isinstance(frame, BrokenFrame)] == [number]


def test_a_name_that_no_file_can_have_costs_its_frame(tmp_path: Path) -> None:
    recording = write_recording(tmp_path, frames=5)
    lines = (recording / "rgb.txt").read_text().splitlines()
    for k, name in ((1, "rgb/a\0b.png"), (3, "rgb/" + "n" * 300 + ".png"), (4, "/dev/zero")):
        lines[k] = f"{lines[k].split()[0]} {name}"
    (recording / "rgb.txt").write_text("\n".join(lines) + "\n")
    with limits(10):
        found = list(open_sequence(recording))
    assert [k for k, frame in enumerate(found) if isinstance(frame, RgbdFrame)] == [1, 4]
    reasons = [frame.reason for frame in found if isinstance(frame, BrokenFrame)]
    assert "no file can have that name" in reasons[0] and "a device" in reasons[2]


def test_the_calibration_goes_before_the_majority(tmp_path: Path) -> None:
    recording = write_recording(tmp_path, frames=5)
    for path in sorted((recording / "rgb").iterdir())[:3]:
        cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    (recording / "calibration.txt").unlink()
    (recording / "camera.toml").write_text("fx=60\nfy=60\ncx=31.5\ncy=23.5\nwidth=64\nheight=48\n")
    assert [type(frame) for frame in open_sequence(recording)] == [BrokenFrame] * 3 + [RgbdFrame] * 2


def test_one_noisy_first_image_is_not_taken_for_swapped_bytes(tmp_path: Path) -> None:
    recording = write_recording(tmp_path, frames=5)
    smooth = np.linspace(5000, 9000, 48 * 64).reshape(48, 64).astype(np.uint16)
    for k, path in enumerate(sorted((recording / "depth").iterdir())):
        cv2.imwrite(str(path), smooth.byteswap() if k == 0 else smooth)
    assert len(list(open_sequence(recording))) == 5


@pytest.mark.parametrize(
    "suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".jp2", ".ppm", ".gif", ".avif", ".hdr", ".ras"]
)
def test_the_size_stands_in_the_header(suffix: str) -> None:
    image = cv2.resize(np.random.default_rng(1).integers(0, 256, (6, 8, 3), np.uint8), (72, 40))
    stored = image.astype(np.float32) if suffix == ".hdr" else image
    data = cv2.imencode(suffix, stored)[1].tobytes()
    assert declared_size(data) == (72, 40)
    for end in range(0, min(len(data), 600), 7):
        assert declared_size(data[:end]) in (None, (72, 40))


def test_images_larger_than_any_camera_has_say_so(tmp_path: Path) -> None:
    with limits(10):
        with pytest.raises(IdRgbdoError, match="at most 16 million pixels, got 60000x60000; replace it"):
            decode_color(enormous_png(8, RGB), "here")
        (tmp_path / "a.png").write_bytes(enormous_png(16, GRAY, 4097))
        with pytest.raises(IdRgbdoError, match="at most 16 million pixels, got 4097x4097"):
            read_depth(tmp_path / "a.png")


BROKEN_BAG_IMAGES: dict[str, bag_writer.Encode] = {
    "no pixel": lambda m, stamp, image: _sized(m.raw(stamp, image, "rgb8"), 0),
    "an odd width in yuv422": lambda m, stamp, image: m.raw(stamp, np.ascontiguousarray(image[:, :-1, :2]), "yuv422"),
    "an unknown encoding": lambda m, stamp, image: m.raw(stamp, image, "purple8"),
    "60000x60000": lambda m, stamp, image: m.compressed(stamp, enormous_png(8, RGB), "png"),
    "fewer rows than said": lambda m, stamp, image: _sized(m.raw(stamp, image, "rgb8"), 48_000),
}


def _sized(made: tuple[str, Any], height: int) -> tuple[str, Any]:
    kind, message = made
    return kind, replace(message, height=height)


@pytest.mark.parametrize("harm", BROKEN_BAG_IMAGES)
def test_an_image_of_a_bag_that_cannot_be_read_costs_its_frame(harm: str, tmp_path: Path) -> None:
    film = recorded.film()
    first = bag_writer.START * 10**9 + round(film.frames[0].timestamp * 1e6) * 1000

    def color(messages: bag_writer.Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        return (BROKEN_BAG_IMAGES[harm] if stamp == first else bag_writer.rgb8)(messages, stamp, image)

    if harm == "60000x60000":
        topics = ("/camera/color/image_raw/compressed", "/camera/depth/image_raw")

        def packed_color(messages: bag_writer.Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
            return (BROKEN_BAG_IMAGES[harm] if stamp == first else bag_writer.png)(messages, stamp, image)

        path = write_bag(film, tmp_path / "a.bag", color=packed_color, topics=topics)
    else:
        path = write_bag(film, tmp_path / "a.bag", color=color)
    with limits(10):
        found = list(open_sequence(path))
    assert all(isinstance(frame, RgbdFrame) for frame in found[1:]) and len(found) >= recorded.FRAMES - 1
    if len(found) == recorded.FRAMES:
        assert isinstance(found[0], BrokenFrame) and str(path) in found[0].reason


def test_a_damaged_page_of_a_database_costs_what_stands_on_it(desk: Film, tmp_path: Path) -> None:
    film = Film(desk.frames[:6], desk.groundtruth)
    (path,) = write_bag(film, tmp_path / "a", 2, StoragePlugin.SQLITE3).glob("*.db3")
    data = path.read_bytes()
    colors = [frame.color.numpy().tobytes() for frame in film.frames if frame.color is not None]
    at = data.find(colors[2][100_000:100_100]) // 4096 * 4096
    path.write_bytes(data[:at] + b"\xff" * 4096 + data[at + 4096 :])  # the number of the next page is lost
    with limits(10):
        sequence = open_sequence(path.parent)
        found = list(sequence)
    assert len(found) == 5 and all(isinstance(frame, RgbdFrame) for frame in found)
    assert any("damaged" in warning for warning in sequence.warnings)


def test_a_damaged_chunk_costs_what_is_in_it(desk: Film, tmp_path: Path) -> None:
    film = Film(desk.frames[:12], desk.groundtruth)
    (path,) = write_bag(film, tmp_path / "a", 2).glob("*.mcap")
    data = path.read_bytes()
    colors = [frame.color.numpy().tobytes() for frame in film.frames if frame.color is not None]
    at = data.find(colors[5][:200])
    path.write_bytes(data[: at - 200] + b"\xff" * 150 + data[at - 50 :])  # the lengths of a message are lost
    with limits(10):
        sequence = open_sequence(path.parent)
        found = list(sequence)
    assert 9 <= len(found) < 12 and all(isinstance(frame, RgbdFrame) for frame in found)
    assert any("damaged" in warning for warning in sequence.warnings)


@pytest.mark.parametrize("name", ["made.bag", "realsense.bag"])
def test_a_bag_that_was_interrupted_is_read_without_its_index(name: str, tmp_path: Path) -> None:
    data = recorded.bag_of("ros1")["made.bag"]
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack_from("<Q", data, at)
    for end, least in ((index, recorded.FRAMES), (index - 30_000, recorded.FRAMES - 2)):
        (tmp_path / name).write_bytes(data[:at] + bytes(8) + data[at + 8 : end])
        sequence = open_sequence(tmp_path / name)
        found = list(sequence)
        assert least <= len(found) <= recorded.FRAMES and all(isinstance(frame, RgbdFrame) for frame in found)
        assert any("interrupted" in warning for warning in sequence.warnings)
    with (tmp_path / name).open("wb") as file:
        file.write(data[:at] + bytes(8) + data[at + 8 :])
        file.truncate(3 << 30)  # a hole
    with limits(10):
        assert len(list(open_sequence(tmp_path / name))) == recorded.FRAMES


def test_pipes_and_devices_are_no_recordings(tmp_path: Path) -> None:
    for name in ("a", "a.bag", "a.mcap", "a.db3"):
        os.mkfifo(tmp_path / name)
        with limits(10), pytest.raises(IdRgbdoError, match="found a pipe or a device"):
            open_sequence(tmp_path / name)
    recording = recorded.write(recorded.bag_of("mcap"), tmp_path)
    fifo(next(recording.glob("*.mcap")))
    with limits(10), pytest.raises(IdRgbdoError, match="found a pipe or a device"):
        open_sequence(recording)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("made.mcap", "5"),
        ("cdr", "5"),
        ("/camera/color/image_raw", "5"),
        ("nanoseconds: ", "nanoseconds: x"),
        ("9", "a: ["),
    ],
)
def test_metadata_of_a_bag_with_other_words_is_one_sentence(before: str, after: str, tmp_path: Path) -> None:
    recording = recorded.write(recorded.bag_of("mcap"), tmp_path)
    text = (recording / "metadata.yaml").read_text()
    assert before in text
    (recording / "metadata.yaml").write_text(text.replace(before, after))
    try:
        assert list(open_sequence(recording))
    except IdRgbdoError as error:
        assert str(recording) in str(error) and "\n" not in str(error)


REFERENCES = {
    "tum": ("made/groundtruth.txt", "1 2 3\n"),
    "icl_png": ("made/livingRoom9.gt.freiburg", "a b c d e f g h\n"),
    "redwood": ("made/trajectory.log", "one two\n"),
    "replica": ("made/traj.txt", "1 0 0"),
    "folder": ("made/groundtruth.txt", "nan nan"),
    "7scenes": ("made/frame-000002.pose.txt", "lost"),
    "scannet": ("made/pose/2.txt", "-"),
    "icl_povray": ("made/scene_00_0002.txt", "cam_pos = [a, b, c]';"),
}


@pytest.mark.parametrize("kind", REFERENCES)
def test_reference_poses_that_cannot_be_read_cost_the_reference(kind: str, tmp_path: Path) -> None:
    """Not the run; where each pose has its file, only that pose."""
    path = recorded.write(recorded.folder_of(kind), tmp_path)
    name, text = REFERENCES[kind]
    whole = open_sequence(path)
    assert whole.groundtruth is not None and not whole.warnings
    (tmp_path / name).write_text(text)
    sequence = open_sequence(path)
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)
    (warning,) = sequence.warnings
    assert str(tmp_path / name) in warning
    apart = Path(name).name.rstrip(".poesxt").endswith("2")
    assert (len(sequence.groundtruth or ()) == len(whole.groundtruth) - 1) == apart
    assert apart or sequence.groundtruth is None


@pytest.mark.parametrize("name", ["a.json", "K.json", "camera.json"])
@pytest.mark.parametrize("harm", ["link", "folder", "pipe"])
def test_what_is_named_like_a_file_beside_a_recording(name: str, harm: str, tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("folder"), tmp_path)
    (path / name).touch()
    {"link": partial(link, target="gone"), "folder": folder, "pipe": fifo}[harm](path / name)
    with limits(10):
        assert len(open_sequence(path)) == recorded.FRAMES


def test_a_calibration_that_is_there_and_no_file_is_said(tmp_path: Path) -> None:
    recording = write_recording(tmp_path, calibration=None)
    (recording / "calibration.txt").mkdir()
    with pytest.raises(IdRgbdoError, match=r"cannot read '.*calibration\.txt': it is a folder, no file"):
        open_sequence(recording)
    (recording / "calibration.txt").rmdir()
    (recording / "calibration.txt").symlink_to("/nowhere")
    with pytest.raises(IdRgbdoError, match=r"cannot read '.*calibration\.txt': No such file"):
        open_sequence(recording)
    (recording / "calibration.txt").unlink()
    os.mkfifo(recording / "camera.toml")
    with limits(10), pytest.raises(IdRgbdoError, match=r"cannot read '.*camera\.toml': it is a pipe, no file"):
        open_sequence(recording)


@pytest.mark.parametrize("text", ["[" * 3000, "- " * 3000, "a: [" + "1," * 15_000 + "]", "x" * 300_000, "", "\0"])
def test_metadata_that_is_none_costs_a_line(text: str, tmp_path: Path) -> None:
    recording = recorded.write(recorded.bag_of("mcap"), tmp_path)
    (recording / "metadata.yaml").write_text(text)
    with limits(10):
        sequence = open_sequence(recording)
        assert all(isinstance(frame, RgbdFrame) for frame in sequence) and len(sequence) == recorded.FRAMES
    assert any(str(recording / "metadata.yaml") in warning for warning in sequence.warnings)


def test_a_distance_of_any_size_is_unknown_depth(tmp_path: Path) -> None:
    """POV-Ray's text may hold numbers that no float32 can."""
    files = recorded.folder_of("icl_povray")
    name = next(name for name in files if name.endswith("2.depth"))
    words = files[name].split()
    words[70] = b"1e300"
    with warnings.catch_warnings(action="error"):
        frames = list(open_sequence(recorded.write({**files, name: b" ".join(words)}, tmp_path)))
    depth = [frame.depth for frame in frames if isinstance(frame, RgbdFrame)]
    assert len(depth) == recorded.FRAMES and float(depth[2][1, 6]) == 0 and int((depth[2] == 0).sum()) == 1
