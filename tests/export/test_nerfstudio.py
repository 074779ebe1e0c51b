"""transforms.json: nerfstudio's documented fields, and rays as nerfstudio makes them end on the filmed surface."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rendered import Film

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.export.images import save, write_images
from idrgbdo_torch.export.own import WRITTEN, make_folder
from idrgbdo_torch.tracker.open3d_loader import load_open3d


@pytest.fixture(scope="module")
def exported(tracked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("nerfstudio")
    assert main(["export", str(tracked), "--to", "nerfstudio", "--out", str(out)]) == 0
    return out


def surface(transforms: dict[str, Any], frame: dict[str, Any], folder: Path) -> np.ndarray:
    """(H, W, 3) points of a depth image in the world; nerfstudio's rays: pixel + 0.5, y up, looking along -z."""
    depth = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED) * 1e-3  # its default unit
    assert depth.shape == (transforms["h"], transforms["w"])
    v, u = np.mgrid[: transforms["h"], : transforms["w"]] + 0.5
    x, y = (u - transforms["cx"]) / transforms["fl_x"], -(v - transforms["cy"]) / transforms["fl_y"]
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1)
    T = np.array(frame["transform_matrix"])
    points = (rays * depth[..., None]) @ T[:3, :3].T + T[:3, 3]
    return np.where(depth[..., None] > 0, points, np.nan)


def test_the_documented_fields_are_there_and_the_files_exist(exported: Path) -> None:
    transforms = json.loads((exported / "transforms.json").read_text())
    assert transforms["camera_model"] == "OPENCV"
    assert [transforms[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")] == [262.5, 262.5, 160, 120, 320, 240]
    assert [transforms[key] for key in ("k1", "k2", "p1", "p2")] == [0, 0, 0, 0]
    assert len(transforms["frames"]) == 40
    for frame in transforms["frames"]:
        T = np.array(frame["transform_matrix"])
        assert T.shape == (4, 4) and np.linalg.det(T[:3, :3]) == pytest.approx(1)
        assert cv2.imread(str(exported / frame["file_path"])).shape == (240, 320, 3)
        depth = cv2.imread(str(exported / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
    assert (exported / transforms["ply_file_path"]).exists()


def test_axes_and_metres_are_right(exported: Path, desk: Film) -> None:
    """All frames' surfaces and the sparse points are one surface, and the camera moves as it truly did."""
    transforms = json.loads((exported / "transforms.json").read_text())
    frames = transforms["frames"]
    o3d = load_open3d()
    filmed = np.concatenate([surface(transforms, frames[k], exported).reshape(-1, 3) for k in (0, 10, 20, 30)])
    known = o3d.utility.Vector3dVector(filmed[~np.isnan(filmed[:, 0])])
    tree = o3d.geometry.KDTreeFlann(o3d.geometry.PointCloud(known))

    def off(points: np.ndarray) -> float:
        return float(np.median([tree.search_knn_vector_3d(point, 1)[2][0] for point in points]) ** 0.5)

    later = surface(transforms, frames[25], exported)[60:180:6, 80:240:6].reshape(-1, 3)
    assert off(later[~np.isnan(later[:, 0])]) < 0.01
    cloud = np.asarray(o3d.io.read_point_cloud(str(exported / transforms["ply_file_path"])).points)
    assert len(cloud) > 1500 and off(cloud[::20]) < 0.01
    moved = np.array(frames[39]["transform_matrix"])[:3, 3] - np.array(frames[0]["transform_matrix"])[:3, 3]
    np.testing.assert_allclose(moved, desk.T(0, 39)[:3, 3].numpy(), atol=0.005)
    looks = -np.array(frames[39]["transform_matrix"])[:3, 2]  # OpenGL's camera looks along -z
    np.testing.assert_allclose(looks, desk.T(0, 39)[:3, 2].numpy(), atol=0.005)


def test_fewer_frames_leave_no_old_images(tracked: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for every, count in (("4", 10), ("8", 5)):
        flags = ["--to", "nerfstudio", "--out", str(out), "--every", every, "--sharpest"]
        assert main(["export", str(tracked), *flags]) == 0
        assert len(json.loads((out / "transforms.json").read_text())["frames"]) == count
        assert len(list((out / "images").iterdir())) == len(list((out / "depth").iterdir())) == count


def test_what_nerfstudio_made_of_other_images_stays(
    tracked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "images").mkdir()
    for name in ("images/frame_00001.png", "transforms.json"):
        (tmp_path / name).write_text("mine")
    assert main(["export", str(tracked), "--to", "nerfstudio", "--out", str(tmp_path)]) == 1
    assert "'transforms.json' that no export wrote" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["frame_00001.png", "images", "transforms.json"]


@pytest.mark.parametrize("kind", WRITTEN)
def test_an_export_replaces_only_what_one_of_its_kind_wrote(tmp_path: Path, kind: str) -> None:
    make_folder(tmp_path / "new", kind)
    for name in WRITTEN[kind]:
        for folder in ("new", "mine"):
            path = tmp_path / folder / name.replace("*", "file")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("")
    make_folder(tmp_path / "new", kind)  # as an export before has made it
    with pytest.raises(IdRgbdoError, match="that no export wrote"):
        make_folder(tmp_path / "mine", kind)
    make_folder(tmp_path / "mine", kind, ours=True)  # in a run's folder, by a version that left no mark


def test_images_of_other_names_stay(desk: Film, tmp_path: Path) -> None:
    for name in ("frame_00001.png", "frame_000039.png"):
        save(tmp_path / "images" / name, np.zeros((4, 4, 3), np.uint8))
    write_images(tmp_path, [0], lambda number: desk.frames[number], False, lambda note: None)
    assert sorted(path.name for path in (tmp_path / "images").iterdir()) == ["frame_000000.png", "frame_00001.png"]
