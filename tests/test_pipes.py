"""No door waits for a pipe, whatever file's name it has, to be read or to be written."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest
from fuzz import recorded
from fuzz.promise import limits
from run_records import record

from idrgbdo_torch.comparison.outcome import RESULTS, Outcome, append_outcome, read_outcomes
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.download.fetch import check_sum, fetch, sha256_of
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.runs.folder import RunFolder
from idrgbdo_torch.runs.own import FILES

BESIDE = (
    *("a.bag", "a.mcap", "a.db3", "a.bag.zstd", "a.mcap.zstd", "a.r3d", "metadata.yaml", "metadata", "metadata.json"),
    *("a.json", "camera.toml", "camera.yaml", "calibration.txt", "K.txt", "rgb.txt", "depth.txt", "groundtruth.txt"),
    *("associations.txt", "traj.txt", "trajectory.log", "a.gt.freiburg", "scene_00.depth", "frame-000000.color.png"),
    *("rgb.mp4", "camera_matrix.csv", "odometry.csv", "rgb", "depth", "color", "results", "intrinsic", "pose"),
)


@pytest.mark.parametrize("kind", [*recorded.WRITERS, *recorded.BAGS])
def test_no_pipe_in_a_recording_is_waited_for(kind: str, tmp_path: Path) -> None:
    """In place of each kind of file, and beside all, together with a metadata.yaml that is none."""
    files = recorded.folder_of(kind) if kind in recorded.WRITERS else recorded.bag_of(kind)
    places = {(Path(name).parent, Path(name).suffix): name for name in files}.values()
    folders = (*recorded.WRITERS, "mcap", "sqlite3")  # the other kinds of bags are single files, or like these
    inside = [f"made/{name}" for name in BESIDE] if kind in folders else []
    for number, name in enumerate([*places, *inside]):
        parent = tmp_path / str(number)
        path = recorded.write(files, parent)
        pipe = parent / name
        if pipe.is_dir():
            continue
        pipe.unlink(missing_ok=True)
        os.mkfifo(pipe)
        for damaged in (False, True):
            if damaged and path.is_dir():
                (path / "metadata.yaml").unlink(missing_ok=True)
                (path / "metadata.yaml").symlink_to("metadata.yaml")
            with limits(10), suppress(IdRgbdoError):
                list(open_sequence(path))


def test_a_pipe_among_the_files_of_a_recording_costs_itself(tmp_path: Path) -> None:
    path = recorded.write(recorded.bag_of("mcap"), tmp_path)
    os.mkfifo(path / "before.db3")
    (path / "metadata.yaml").unlink()
    with limits(10):
        sequence = open_sequence(path)
        assert sum(isinstance(frame, RgbdFrame) for frame in sequence) == recorded.FRAMES
    assert any("'before.db3': it is a pipe" in warning.replace("[Errno 22] ", "") for warning in sequence.warnings)


@pytest.mark.parametrize("name", [*FILES, "frames.csv.part", "config.toml.part", "summary.json.part"])
def test_no_pipe_in_a_run_folder_is_waited_for(name: str, tmp_path: Path) -> None:
    (tmp_path / "frames.csv").touch()  # of a run
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with limits(10), suppress(IdRgbdoError), RunFolder(tmp_path) as run:
        run.append(record(0))


def test_no_pipe_among_results_and_downloads_is_waited_for(tmp_path: Path) -> None:
    for name in (RESULTS, "sums", "file"):
        os.mkfifo(tmp_path / name)
    with limits(10):
        for call in (append_outcome, lambda folder, _: read_outcomes(folder)):
            with pytest.raises(IdRgbdoError, match=r"results\.jsonl"):
                call(tmp_path, Outcome("a", "s", 0, "c", {}))
        with pytest.raises(OSError, match="it is a pipe"):
            sha256_of(tmp_path / "file")
        (tmp_path / "whole").touch()
        for file, sums in (("file", "none"), ("whole", "sums")):
            with pytest.raises(IdRgbdoError, match="it is a pipe"):
                check_sum(tmp_path / file, tmp_path / sums)
        for name in ("b.part", "c.part.json"):
            os.mkfifo(tmp_path / name)
            with pytest.raises(IdRgbdoError, match="download"):
                fetch("http://127.0.0.1:1/x", tmp_path / name.partition(".")[0], tries=1, wait_s=0.0)
