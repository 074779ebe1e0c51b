"""COLMAP's model: as its documentation has the files, as pycolmap reads them, and true in the images."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.commands.cli import main

DEPTH_SHARE = 0.02  # relative difference between the depth of a point and that of the image


class Model(NamedTuple):
    """What a model's files say, numbers as they stand there."""

    camera: tuple[Any, ...]  # id, model, width, height, fx, fy, cx, cy
    images: dict[int, tuple[Any, ...]]  # id: name, qw qx qy qz tx ty tz, observations (x, y, point)
    points: dict[int, tuple[Any, ...]]  # id: xyz, rgb, error, track


@pytest.fixture(scope="module")
def exported(tracked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("colmap")
    assert main(["export", str(tracked), "--to", "colmap", "--out", str(out)]) == 0
    return out


def read_binary(folder: Path) -> Model:
    """By https://colmap.github.io/format.html, not by the writer."""
    data, at = b"", 0

    def take(layout: str) -> tuple[Any, ...]:
        nonlocal at
        values = struct.unpack_from("<" + layout, data, at)
        at += struct.calcsize("<" + layout)
        return values

    data, at = (folder / "cameras.bin").read_bytes(), 0
    assert take("Q") == (1,)
    camera = take("IiQQ4d")
    assert at == len(data)
    data, at = (folder / "images.bin").read_bytes(), 0
    images = {}
    for _ in range(take("Q")[0]):
        number, *pose, _ = take("I7dI")
        end = data.index(b"\0", at)
        name, at = data[at:end].decode(), end + 1
        images[number] = (name, pose, [take("ddQ") for _ in range(take("Q")[0])])
    assert at == len(data)
    data, at = (folder / "points3D.bin").read_bytes(), 0
    points = {}
    for _ in range(take("Q")[0]):
        number, x, y, z, r, g, b, error = take("Q3d3Bd")
        points[number] = ((x, y, z), (r, g, b), error, [take("II") for _ in range(take("Q")[0])])
    assert at == len(data)
    return Model(camera, images, points)


def read_text(folder: Path) -> Model:
    """The same from the text files."""

    def lines(name: str) -> list[list[str]]:
        return [line.split() for line in (folder / name).read_text().splitlines() if not line.startswith("#")]

    (camera,) = lines("cameras.txt")
    rows = lines("images.txt")
    images = {
        int(head[0]): (head[9], [float(x) for x in head[1:8]], np.array(seen, float).reshape(-1, 3).tolist())
        for head, seen in zip(rows[::2], rows[1::2], strict=True)
    }
    points = {
        int(row[0]): (
            tuple(map(float, row[1:4])),
            tuple(map(int, row[4:7])),
            float(row[7]),
            [tuple(pair) for pair in np.array(row[8:], int).reshape(-1, 2).tolist()],
        )
        for row in lines("points3D.txt")
    }
    return Model((int(camera[0]), camera[1], *map(float, camera[2:])), images, points)


def rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.asarray(cv2.Rodrigues(2 * np.arctan2(np.linalg.norm([x, y, z]), w) * _unit(np.array([x, y, z])))[0])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-300)


def test_text_and_binary_say_the_same(exported: Path) -> None:
    binary, text = read_binary(exported / "sparse" / "0"), read_text(exported / "sparse" / "text")
    assert (binary.camera[:2], text.camera[:2]) == ((1, 1), (1, "PINHOLE"))
    assert binary.camera[2:] == (*(320, 240), 262.5, 262.5, 160.0, 120.0)  # (0.5, 0.5) is the first pixel's centre
    assert text.camera[2:] == binary.camera[2:]
    assert binary.images.keys() == text.images.keys() and binary.points.keys() == text.points.keys()
    for number, (name, pose, seen) in binary.images.items():
        assert text.images[number][0] == name
        np.testing.assert_allclose(text.images[number][1], pose, atol=1e-10)
        np.testing.assert_allclose(np.reshape(text.images[number][2], (-1, 3)), np.reshape(seen, (-1, 3)), atol=1e-4)
    for number, (xyz, rgb, error, track) in binary.points.items():
        other = text.points[number]
        assert (other[1], other[3]) == (rgb, track)
        np.testing.assert_allclose(other[0], xyz, atol=1e-10)
        assert other[2] == pytest.approx(error, abs=1e-4)


def test_points_are_seen_where_they_are_and_their_depth_agrees(exported: Path, desk: Film) -> None:
    model = read_binary(exported / "sparse" / "0")
    _, _, _, _, fx, fy, cx, cy = model.camera
    errors, depth_errors, counts = [], [], []
    for number, (name, pose, seen) in model.images.items():
        R, t = rotation(*pose[:4]), np.array(pose[4:])
        depth = cv2.imread(str(exported / "depth" / name), cv2.IMREAD_UNCHANGED) / 1000.0
        original = desk.frames[int(name[6:12])]
        assert original.color is not None
        np.testing.assert_allclose(depth, original.depth.numpy(), atol=6e-4)
        picture = cv2.imread(str(exported / "images" / name))
        np.testing.assert_array_equal(picture[..., ::-1], original.color.numpy())
        for place, (u, v, point) in enumerate(seen):
            xyz, _, _, track = model.points[point]
            assert (number, place) in track
            x, y, z = R @ np.array(xyz) + t
            expected = np.array([fx * x / z + cx, fy * y / z + cy])
            errors.append(np.linalg.norm([u, v] - expected))
            column, row = np.floor(expected).astype(int)  # COLMAP's pixel (0, 0) reaches from 0 to 1
            if depth[row, column] > 0:
                depth_errors.append(abs(depth[row, column] / z - 1))
    counts = [len(track) for *_, track in model.points.values()]
    assert len(model.points) > 1000 and min(counts) >= 2 and len(errors) == sum(counts)
    assert np.median(errors) < 0.5 and np.quantile(errors, 0.95) < 2.0
    assert np.median(depth_errors) < 0.005 and np.mean(np.array(depth_errors) < DEPTH_SHARE) > 0.95


def test_the_first_keyframe_shows_its_own_points_at_the_centres_of_pixels(exported: Path) -> None:
    model = read_binary(exported / "sparse" / "0")
    _, pose, seen = model.images[1]
    fx, cx = model.camera[4], model.camera[6]
    np.testing.assert_allclose(pose, [1, 0, 0, 0, 0, 0, 0], atol=1e-8)  # the world
    own = [(u, v, p) for u, v, p in seen if (u % 1, v % 1) == (0.5, 0.5)]
    assert len(own) > 200
    off = [abs(fx * x / z + cx - u) for u, _, p in own for (x, _, z) in [model.points[p][0]]]
    assert max(off) < 1e-3


def test_what_is_found_lies_where_the_true_poses_say(exported: Path, desk: Film) -> None:
    """Observations are measured: they agree with the film's exact poses, which the export never saw."""
    model = read_binary(exported / "sparse" / "0")
    _, _, _, _, fx, fy, cx, cy = model.camera
    frame_of = {number: int(name[6:12]) for number, (name, _, _) in model.images.items()}
    errors = []
    for *_, track in model.points.values():
        for (a, i), (b, j) in pairwise(track):
            (u, v, _), (other_u, other_v, _) = model.images[a][2][i], model.images[b][2][j]
            z = float(desk.frames[frame_of[a]].depth[int(v), int(u)])
            if z == 0:
                continue
            P = desk.T(frame_of[b], frame_of[a]).numpy() @ [(u - cx) / fx * z, (v - cy) / fy * z, z, 1.0]
            errors.append(np.hypot(fx * P[0] / P[2] + cx - other_u, fy * P[1] / P[2] + cy - other_v))
    assert len(errors) > 1000 and np.median(errors) < 0.5


def test_pycolmap_reads_it(exported: Path, desk: Film) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="needs pycolmap (38 MB): pip install pycolmap")
    for folder in ("0", "text"):
        model = pycolmap.Reconstruction(exported / "sparse" / folder)
        assert (model.num_reg_images(), model.num_points3D()) == (
            40,
            len(read_binary(exported / "sparse" / "0").points),
        )
        assert model.compute_mean_track_length() > 2
        said = model.compute_mean_reprojection_error()
        model.update_point_3d_errors()
        assert model.compute_mean_reprojection_error() == pytest.approx(said, abs=1e-3) and said < 1.0
        image = next(one for one in model.images.values() if one.name == "frame_000030.png")
        truth = desk.T(0, 30)[:3, 3].numpy()
        assert np.linalg.norm(image.projection_center() - truth) < 0.005


def test_gsplat_has_colour_and_the_binary_model_with_every_keyframe(tracked: Path, tmp_path: Path) -> None:
    assert main(["export", str(tracked), "--to", "gsplat", "--out", str(tmp_path), "--every", "10"]) == 0
    model = read_binary(tmp_path / "sparse" / "0")
    keyframes = {int(name[6:12]) for name, _, seen in model.images.values() if seen}
    assert {int(name[6:12]) for name, _, _ in model.images.values()} == {0, 10, 20, 30} | keyframes
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == ["images", "sparse"]
    assert len(list((tmp_path / "images").iterdir())) == len(model.images) < 40
