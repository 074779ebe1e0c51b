"""The viewer: what it wrote is read back with Rerun's own reader; without package or display one line says so."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from recordings import ROOT
from rendered import Film
from test_readme import blocks

from idrgbdo_torch import BrokenFrame, IdRgbdo, Status, run
from idrgbdo_torch.commands import cli
from idrgbdo_torch.definitions.se3 import inverse, transform
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.odometry import Record, Run
from idrgbdo_torch.report.viewer import FREEDOMS, Viewer, open_viewer

COUNT = 24
LOST = 10  # a frame that cannot be read


@dataclass(frozen=True)
class Shown:
    """A run, and everything that was logged of it."""

    done: Run
    odometry: IdRgbdo
    rows: dict[str, list[dict[str, Any]]]  # by entity, in the order of time

    def column(self, entity: str, component: str) -> list[Any]:
        """All values that were logged, None left out."""
        values = [row.get(component) for row in self.rows[entity]]
        return [value for value in values if value is not None]


def read(path: Path) -> dict[str, list[dict[str, Any]]]:
    """An .rrd file as rows by entity."""
    from rerun.chunk import RrdReader

    rows: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(str(path)).stream():
        rows.setdefault(chunk.entity_path, []).extend(chunk.to_record_batch().to_pylist())
    return {name: sorted(some, key=lambda row: row.get("frame") or 0) for name, some in rows.items()}


@pytest.fixture(scope="module")
def shown(desk: Film, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    pytest.importorskip("rerun")
    path = tmp_path_factory.mktemp("viewer") / "some" / "desk.rrd"
    frames: list[Any] = list(desk.frames[:COUNT])
    frames[LOST] = BrokenFrame(frames[LOST].timestamp, "half a file")
    odometry, records = IdRgbdo(), list[Record]()
    with Viewer("desk", save=path) as viewer:
        done = run(odometry, viewer.stream(iter(frames), odometry, records, desk.groundtruth), records.append)
    return Shown(done, odometry, read(path))


def test_every_frame_is_there_with_image_pose_and_points(shown: Shown) -> None:
    assert len(shown.column("/world/camera/image", "EncodedImage:blob")) == COUNT - 1
    translations = shown.column("/world/camera", "Transform3D:translation")
    expected = shown.done.trajectory().positions
    np.testing.assert_allclose(np.array(translations)[:, 0], expected, atol=1e-6)
    intrinsics = np.array(shown.column("/world/camera/image", "Pinhole:image_from_camera")[0]).reshape(3, 3).T
    np.testing.assert_allclose(intrinsics, [[262.5, 0, 159.5], [0, 262.5, 119.5], [0, 0, 1]])
    points = shown.column("/world/camera/image/points", "Points2D:positions")
    assert [len(uv) for uv in points].count(24) >= COUNT - 3
    times = [row["time"] for row in shown.rows["/world/camera"]]
    assert len(set(times)) == COUNT and [row["frame"] for row in shown.rows["/world/camera"]] == list(range(COUNT))


def test_points_and_residuals_are_the_tracker_s(shown: Shown) -> None:
    uv, _ = shown.odometry.last_points()
    last = np.array(shown.column("/world/camera/image/points", "Points2D:positions")[-1])
    np.testing.assert_allclose(last, uv, atol=1e-3)
    assert shown.odometry.last is not None
    _, tracked = shown.odometry.last
    seen = tracked.rms[tracked.rms >= 0]
    labels = shown.column("/world/camera/image/residuals", "Points2D:labels")[-1]
    assert labels == [f"{value:.1f} sigma" for value in seen]
    at = np.array(shown.column("/world/camera/image/residuals", "Points2D:positions")[-1])
    assert np.linalg.norm(at[:, None] - last, axis=-1).min(axis=1).max() < 0.01  # they lie on the points
    medians = shown.column("/numbers/median_residual", "Scalars:scalars")
    assert medians[-1] == pytest.approx([np.median(seen)])


def test_entropy_keyframes_window_and_reference(shown: Shown, desk: Film) -> None:
    tracked = [r.result for r in shown.done.records if r.result.entropy_bits]
    for k, name in enumerate(FREEDOMS):
        values = shown.column(f"/entropy/{name.replace(' ', '_')}", "Scalars:scalars")
        np.testing.assert_allclose(np.array(values)[:, 0], [result.entropy_bits[k] for result in tracked])
    keyframes = sum(r.result.keyframe for r in shown.done.records)
    assert keyframes >= 3
    for number in range(keyframes):
        assert shown.column(f"/world/keyframes/{number}/points", "Points3D:positions")
        refined = shown.column(f"/world/keyframes/{number}", "Transform3D:translation")[-1][0]
        np.testing.assert_allclose(
            refined, np.linalg.inv(shown.odometry.history.keyframe_poses[number])[:3, 3], atol=1e-6
        )
    window = shown.column("/world/window", "LineStrips3D:strips")[-1][0]
    assert len(window) == len(shown.odometry.history.in_window)
    truth = transform(inverse(desk.groundtruth.T_world_cam[0]), desk.groundtruth.positions)
    np.testing.assert_allclose(shown.column("/world/reference", "LineStrips3D:strips")[0][0], truth, atol=1e-6)
    path = shown.column("/world/trajectory/0", "LineStrips3D:strips")[-1][0]
    np.testing.assert_allclose(path, shown.done.trajectory().positions, atol=1e-6)


def test_what_went_wrong_is_in_the_log(shown: Shown) -> None:
    notes = [row for row in shown.rows["/log"] if row.get("TextLog:text")]
    assert any(note["frame"] == LOST and note["TextLog:text"] == ["half a file"] for note in notes)
    assert shown.done.statuses[LOST] is Status.LOST


def test_looking_changes_nothing(shown: Shown, desk: Film) -> None:
    frames: list[Any] = list(desk.frames[:COUNT])
    frames[LOST] = BrokenFrame(frames[LOST].timestamp, "half a file")
    alone = run(IdRgbdo(), frames)
    assert torch.equal(alone.trajectory().T_world_cam, shown.done.trajectory().T_world_cam)


def test_the_command_writes_a_file(make_recording: Callable[..., Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    target = tmp_path / "run.rrd"
    assert cli.main(["run", str(make_recording()), "--out", str(tmp_path / "run"), "--save-rrd", str(target)]) == 0
    assert "/world/camera/image" in read(target)


def test_without_the_package_one_line_says_what_to_install(
    make_recording: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    out = tmp_path / "run"
    assert cli.main(["run", str(make_recording()), "--out", str(out), "--save-rrd", str(tmp_path / "x.rrd")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: viewer: needs Rerun") and 'pip install "idrgbdo_torch[viewer]"' in line
    assert not out.exists()


def test_without_a_display_a_window_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun")
    if sys.platform != "linux":
        pytest.skip("Linux has DISPLAY and WAYLAND_DISPLAY")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(IdRgbdoError, match="--save-rrd"):
        Viewer("desk", window=True)


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    (tmp_path / "file").write_text("")
    with pytest.raises(IdRgbdoError, match="save_rrd: cannot write"):
        Viewer("desk", save=tmp_path / "file" / "x.rrd")


def test_no_viewer_unless_asked() -> None:
    with open_viewer("desk", window=False, save=None) as viewer:
        assert viewer is None


def test_the_page_s_example_runs(
    make_recording: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("rerun")
    monkeypatch.chdir(make_recording(name="my_recording").parent)
    (example,) = blocks(ROOT / "docs" / "viewer.md", "python")
    exec(example, {})
    assert len(read(Path("run.rrd"))["/world/camera"]) == 4


def test_the_page_names_what_is_there(shown: Shown) -> None:
    page = (ROOT / "docs" / "viewer.md").read_text()
    named = set(re.findall(r"`((?:world|entropy|numbers|log)[\w/]*)`", page))
    there = {name.removeprefix("/") for name in shown.rows}
    assert len(named) >= 10
    for name in named:
        assert any(entity == name or entity.startswith(f"{name}/") for entity in there), name
