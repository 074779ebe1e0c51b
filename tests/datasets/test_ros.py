"""ROS 1 bags and ROS 2 recordings: the same film gives the same trajectory as a folder of files."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import bag_writer
import cv2
import format_writers
import numpy as np
import pytest
import torch
from bag_writer import START, Messages, write_bag
from numpy.testing import assert_array_equal
from rendered import Film
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from idrgbdo_torch import IdRgbdo, Pinhole
from idrgbdo_torch.datasets import RgbdSequence, guess, open_sequence
from idrgbdo_torch.datasets.ros_images import color_image, depth_image
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.odometry import Run, Status, run
from idrgbdo_torch.trajectory import Trajectory


@pytest.fixture(scope="module")
def film(desk: Film) -> Film:
    """30 frames of the rendered desk."""
    return Film(desk.frames[:30], desk.groundtruth.at(torch.arange(30)))


def tracked(sequence: RgbdSequence) -> Run:
    return run(IdRgbdo(), sequence)


def test_a_folder_a_bag_and_an_mcap_give_the_same_trajectory(film: Film, tmp_path: Path) -> None:
    format_writers.tum(film, tmp_path / "tum")
    expected = tracked(open_sequence(tmp_path / "tum")).trajectory()
    recordings = [
        write_bag(film, tmp_path / "film.bag", 1),
        write_bag(film, tmp_path / "mcap", 2),
        write_bag(film, tmp_path / "sqlite", 2, StoragePlugin.SQLITE3),
    ]
    recordings.append(next((tmp_path / "mcap").glob("*.mcap")))  # the file alone does too
    for path, version in zip(recordings, (1, 2, 2, 2), strict=True):
        assert guess(path) == "ros"
        sequence = open_sequence(path)
        assert sequence.warnings == []
        assert sequence.recognised.startswith(
            f"ROS {version} recording, /camera/color/image_raw and /camera/aligned_depth_to_color/image_raw: 30 frames"
        )
        assert sequence.timestamps == pytest.approx([START + f.timestamp for f in film.frames], abs=1e-6)
        assert sequence.camera == film.frames[0].camera
        done = tracked(sequence)
        assert Status.LOST not in done.statuses
        assert float((done.trajectory().T_world_cam - expected.T_world_cam).abs().max()) < 1e-6
    truth = Trajectory(expected.timestamps, film.groundtruth.T_world_cam)
    assert evaluate(expected, truth).ate.rmse_m <= 0.01


@pytest.mark.parametrize("version", [1, 2])
def test_compressed_images(film: Film, tmp_path: Path, version: int) -> None:
    names = ("/camera/color/image_raw/compressed", "/camera/aligned_depth_to_color/image_raw/compressedDepth")
    path = write_bag(
        *(film, tmp_path / ("a.bag" if version == 1 else "a"), version),
        color=bag_writer.png,
        depth=bag_writer.compressed_depth,
        topics=names,
    )
    sequence = open_sequence(path)
    frame = sequence.read(4)
    assert isinstance(frame, RgbdFrame)
    assert frame.color is not None and film.frames[4].color is not None
    assert_array_equal(frame.color.numpy(), film.frames[4].color.numpy())
    assert float((frame.depth - film.frames[4].depth).abs().max()) < 0.00051
    done = tracked(sequence)
    truth = Trajectory(done.trajectory().timestamps, film.groundtruth.T_world_cam)
    assert evaluate(done.trajectory(), truth).ate.rmse_m <= 0.01


def test_one_broken_image_costs_one_frame(film: Film, tmp_path: Path) -> None:
    shots = 0

    def damaged(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        nonlocal shots
        shots += 1
        kind, message = bag_writer.png(messages, stamp, image)
        if shots == 8:
            message = messages.compressed(stamp, message.data.tobytes()[:500], message.format)[1]
        return kind, message

    short = Film(film.frames[:12], film.groundtruth)
    sequence = open_sequence(write_bag(short, tmp_path / "film.bag", color=damaged, depth=bag_writer.millimetres))
    frames = list(sequence)
    assert [index for index, frame in enumerate(frames) if isinstance(frame, BrokenFrame)] == [7]
    lost = frames[7]
    assert isinstance(lost, BrokenFrame)
    assert "frame 7, /camera/color/image_raw: truncated PNG" in lost.reason
    statuses = tracked(sequence).statuses
    assert [index for index, status in enumerate(statuses) if status is Status.LOST] == [7]


def test_start_every_and_max_frames(film: Film, tmp_path: Path) -> None:
    path = write_bag(Film(film.frames[:12], film.groundtruth), tmp_path / "film.bag")
    whole = open_sequence(path).timestamps
    assert open_sequence(path, start=2, every=3, max_frames=3).timestamps == [whole[2], whole[5], whole[8]]


def test_topics_are_chosen_or_named(film: Film, tmp_path: Path) -> None:
    short = Film(film.frames[:3], film.groundtruth)
    path = write_bag(short, tmp_path / "a.bag", topics=("/left/image_mono", "/stereo/depth"))
    assert "/left/image_mono and /stereo/depth" in open_sequence(path).recognised
    with pytest.raises(IdRgbdoError, match="expected the topic '/nothing' with images, found these: /left/image_mono"):
        open_sequence(path, color_topic="/nothing")
    with pytest.raises(IdRgbdoError, match="expected '/stereo/camera_info', found /left/camera_info; pass --camera"):
        open_sequence(path, color_topic="/stereo/depth")
    alone = write_bag(short, tmp_path / "b.bag", topics=("/left/image", "/infra/image"))
    with pytest.raises(IdRgbdoError, match="expected a depth topic with images"):
        open_sequence(alone)
    assert len(open_sequence(alone, depth_topic="/infra/image")) == 3


def test_a_camera_file_replaces_camera_info(film: Film, tmp_path: Path) -> None:
    path = write_bag(Film(film.frames[:3], film.groundtruth), tmp_path / "film.bag")
    (tmp_path / "camera.toml").write_text("fx = 260\nfy = 261\ncx = 160\ncy = 120\ndepth_scale = 2")
    sequence = open_sequence(path, camera=tmp_path / "camera.toml")
    frame = sequence.read(0)
    assert isinstance(frame, RgbdFrame)
    assert sequence.camera.fy == 261
    torch.testing.assert_close(frame.depth, film.frames[0].depth / 2, rtol=0, atol=1e-6)


def test_images_of_different_cameras_are_noticed(film: Film, tmp_path: Path) -> None:
    def elsewhere(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        kind, message = bag_writer.metres(messages, stamp, image)
        message.header.frame_id = "depth_optical_frame"
        return kind, message

    (warning,) = open_sequence(write_bag(film, tmp_path / "film.bag", depth=elsewhere)).warnings
    assert "depth in 'depth_optical_frame': if depth is not registered" in warning


def test_headers_without_time_fall_back_on_the_time_of_recording(film: Film, tmp_path: Path) -> None:
    def timeless(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        return bag_writer.rgb8(messages, 0, image) if image.ndim == 3 else bag_writer.metres(messages, 0, image)

    short = Film(film.frames[:4], film.groundtruth)
    sequence = open_sequence(write_bag(short, tmp_path / "film.bag", color=timeless, depth=timeless))
    assert sequence.timestamps == pytest.approx([START + f.timestamp + 0.03 for f in short.frames], abs=1e-6)
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)


@pytest.mark.parametrize("version", [1, 2])
def test_images_recorded_at_one_time_are_told_apart(film: Film, tmp_path: Path, version: int) -> None:
    short = Film(film.frames[:5], film.groundtruth)
    path = write_bag(short, tmp_path / ("a.bag" if version == 1 else "a"), version, burst=True)
    for frame, expected in zip(open_sequence(path), short.frames, strict=True):
        assert isinstance(frame, RgbdFrame)
        assert_array_equal(frame.depth.numpy(), expected.depth.numpy())
        np.testing.assert_allclose(frame.gray.numpy(), expected.gray.numpy(), atol=1e-3)


@pytest.mark.parametrize("version", [1, 2])
def test_whatever_is_damaged_there_is_no_traceback(tmp_path: Path, version: int) -> None:
    """Bytes changed or cut off at random: frames, broken frames, or one IdRgbdoError; nothing else is raised."""
    rng = np.random.default_rng(version)
    camera = Pinhole(width=16, height=12, fx=15, fy=15, cx=7.5, cy=5.5)
    images = torch.full((12, 16), 9.0), torch.full((12, 16), 1.5), camera, torch.full((12, 16, 3), 9, dtype=torch.uint8)
    tiny = Film(tuple(RgbdFrame(k / 30, *images) for k in range(5)), Trajectory(*_still(5)))
    path = write_bag(tiny, tmp_path / ("a.bag" if version == 1 else "a"), version)
    whole = (path if version == 1 else next(path.glob("*.mcap"))).read_bytes()
    damaged = tmp_path / f"damaged{'.bag' if version == 1 else '.mcap'}"
    refused = 0
    for attempt in range(150):
        data = bytearray(whole)
        for place in rng.integers(len(data), size=3):
            data[place] = rng.integers(256)
        damaged.write_bytes(data[: rng.integers(len(data))] if attempt % 5 == 0 else data)
        try:
            for frame in open_sequence(damaged):
                assert isinstance(frame, RgbdFrame | BrokenFrame)
        except IdRgbdoError as error:
            refused += 1
            assert str(damaged) in str(error)
    assert 5 <= refused < 60


def _still(frames: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Times and poses of a camera that does not move."""
    return torch.arange(frames, dtype=torch.float64), torch.eye(4, dtype=torch.float64).repeat(frames, 1, 1)


def test_damaged_and_foreign_files_are_one_line(film: Film, tmp_path: Path) -> None:
    for name in ("a.bag", "a.mcap", "a.db3"):
        (tmp_path / name).write_bytes(b"no recording" * 40)
        with pytest.raises(IdRgbdoError, match="cannot read this as a ROS recording"):
            open_sequence(tmp_path / name)
    whole = write_bag(film, tmp_path / "b.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(whole[: len(whole) // 2])  # as where copying was interrupted
    cut = open_sequence(tmp_path / "cut.bag")
    assert 13 <= len(cut) <= 15 and all(isinstance(frame, RgbdFrame) for frame in cut)
    (warning,) = cut.warnings
    assert "left out (no records from byte" in warning


def test_without_rosbags_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(IdRgbdoError, match=r'pip install "idrgbdo_torch\[ros\]"'):
        open_sequence(tmp_path / "a.mcap")


@pytest.mark.parametrize("version", [1, 2])
def test_raw_encodings(version: int) -> None:
    messages = Messages(version)
    bgr = np.random.default_rng(3).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    gray = bgr[..., 0].copy()
    alpha = np.dstack([bgr, gray])
    cases = [
        (bgr, "bgr8", bgr),
        (np.ascontiguousarray(bgr[..., ::-1]), "rgb8", bgr),
        (alpha, "bgra8", bgr),
        (np.ascontiguousarray(alpha[..., [2, 1, 0, 3]]), "rgba8", bgr),
        (gray, "mono8", np.dstack([gray] * 3)),
    ]
    for image, encoding, expected in cases:
        for padding in (0, 5):
            message = messages.raw(7, image, encoding, padding)[1]
            assert_array_equal(color_image(message, ""), expected)
    depth = np.random.default_rng(4).integers(0, 60000, (6, 8), dtype=np.uint16)
    for big in (False, True):
        assert_array_equal(depth_image(messages.raw(7, depth, "16UC1", 2, big)[1], ""), depth)
        floats = depth.astype(np.float32) / 7
        assert_array_equal(depth_image(messages.raw(7, floats, "32FC1", 0, big)[1], ""), floats)


def test_yuv_is_converted() -> None:
    gray = np.full((4, 8), 120, np.uint8)
    yuyv = np.dstack([gray, np.full_like(gray, 128)])
    message = Messages(2).raw(7, yuyv, "yuv422_yuy2")[1]
    assert abs(color_image(message, "").astype(int) - 121).max() <= 1
    uyvy = np.ascontiguousarray(yuyv[..., ::-1])
    assert abs(color_image(Messages(2).raw(7, uyvy, "yuv422")[1], "").astype(int) - 121).max() <= 1


def test_unreadable_images_are_refused() -> None:
    messages = Messages(1)
    image = np.zeros((4, 8, 3), np.uint8)
    with pytest.raises(IdRgbdoError, match="got 'bayer_rggb16'"):
        color_image(messages.raw(7, image, "bayer_rggb16")[1], "here")
    short = messages.raw(7, image, "rgb8")[1]
    short.data = short.data[:50]
    with pytest.raises(IdRgbdoError, match="expected 4 rows of 24 bytes, got 50"):
        color_image(short, "here")
    with pytest.raises(IdRgbdoError, match="got 'rgb8'; record another topic, or name it with --depth-topic"):
        depth_image(messages.raw(7, image, "rgb8")[1], "here")
    with pytest.raises(IdRgbdoError, match="got RVL"):
        depth_image(messages.compressed(7, bytes(40), "16UC1; compressedDepth rvl")[1], "here")


def test_quantised_inverse_depth_is_depth_again() -> None:
    """compressed_depth_image_transport stores 32FC1 as round(a / depth + b); a and b stand in its header."""
    a = 100.0 * (100 + 1)  # its default quantization of 100, up to 10 m
    b = 1 - a / 10
    depth = np.linspace(0.5, 9, 48, dtype=np.float32).reshape(6, 8)
    quantised = np.round(a / depth + b).astype(np.uint16)
    quantised[0, 0] = 0
    data = cv2.imencode(".png", quantised)[1].tobytes()
    message = Messages(2).compressed(7, struct.pack("<iff", 0, a, b) + data, "32FC1; compressedDepth png")[1]
    decoded = depth_image(message, "")
    assert decoded[0, 0] == 0
    np.testing.assert_allclose(decoded.ravel()[1:], depth.ravel()[1:], rtol=1e-3)


def with_empty_topics(film: Film, path: Path, version: int, empty: dict[str, tuple[str, int]]) -> Path:
    """A good compressed recording, and topics (name: encoding, messages) whose messages hold nothing."""
    messages = Messages(version)
    color, depth = (f"/camera/{name}/image_raw" for name in ("color", "aligned_depth_to_color"))
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        connections = {}
        for topic, (encoding, count) in empty.items():
            kind = bag_writer.COMPRESSED if "ompressed" in topic else bag_writer.IMAGE
            connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            for k in range(count):
                stamp = START * 10**9 + k * 33_333_333
                message = messages.compressed(stamp, b"", encoding)
                writer.write(connections[topic], stamp, messages.bytes(*message))
        for frame in film.frames:
            stamp = START * 10**9 + round(frame.timestamp * 1e6) * 1000
            assert frame.color is not None
            for topic, (kind, message) in (
                ("/camera/color/camera_info", messages.info(stamp, film)),
                (f"{color}/compressed", bag_writer.png(messages, stamp, frame.color.numpy())),
                (f"{depth}/compressedDepth", bag_writer.compressed_depth(messages, stamp, frame.depth.numpy())),
            ):
                if topic not in empty:
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
                    writer.write(connections[topic], stamp, messages.bytes(kind, message))
    return path


COLOR_TOPIC, DEPTH_TOPIC = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    "empty",
    [
        {DEPTH_TOPIC: ("16UC1", 0)},
        {DEPTH_TOPIC + "/compressed": ("16UC1; jpeg compressed mono8", 6)},
        {COLOR_TOPIC: ("rgb8", 0)},
        {COLOR_TOPIC: ("rgb8", 0), DEPTH_TOPIC: ("16UC1", 0), DEPTH_TOPIC + "/compressed": ("16UC1; jpeg", 6)},
    ],
)
def test_topics_that_hold_nothing_are_not_chosen(
    film: Film, tmp_path: Path, version: int, empty: dict[str, tuple[str, int]]
) -> None:
    short = Film(film.frames[:6], film.groundtruth)
    sequence = open_sequence(
        with_empty_topics(short, tmp_path / ("film.bag" if version == 1 else "film"), version, empty)
    )
    assert f"{COLOR_TOPIC}/compressed and {DEPTH_TOPIC}/compressedDepth: 6 frames" in sequence.recognised
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)


def test_nothing_but_empty_messages_is_said(film: Film, tmp_path: Path) -> None:
    short = Film(film.frames[:6], film.groundtruth)
    empty = {DEPTH_TOPIC: ("16UC1", 0), DEPTH_TOPIC + "/compressedDepth": ("16UC1; compressedDepth png", 6)}
    with pytest.raises(IdRgbdoError, match=rf"the messages of {DEPTH_TOPIC}, {DEPTH_TOPIC}/compressedDepth are empty"):
        open_sequence(with_empty_topics(short, tmp_path / "a", 2, empty))
