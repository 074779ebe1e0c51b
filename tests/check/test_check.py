"""The check of a recording: it names the fault that was put in, and finds nothing wrong in good ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from faults import Frames, Recording, dropped, late_depth, moved_depth, other_camera, scaled_depth
from rendered import Film

from idrgbdo_torch.check import Report, Verdict, check
from idrgbdo_torch.check.images import edge_width
from idrgbdo_torch.check.picture import draw
from idrgbdo_torch.check.timing import timing
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.definitions.camera import Pinhole
from idrgbdo_torch.frame import BrokenFrame, RgbdFrame
from idrgbdo_torch.trajectory import Trajectory


@pytest.fixture
def good(desk: Film) -> Film:
    """A desk with full sensor noise."""
    return desk


def names(report: Report, verdict: Verdict = Verdict.FAULT) -> list[str]:
    return [finding.name for finding in report.findings if finding.verdict is verdict]


def value(report: Report, name: str) -> str:
    return next(finding.value for finding in report.findings if finding.name == name)


def advice(report: Report, name: str) -> str:
    return next(finding.advice for finding in report.findings if finding.name == name)


def test_a_good_recording_has_no_finding(good: Film) -> None:
    report = check(Recording(list(good.frames), good.groundtruth))
    assert {finding.verdict for finding in report.findings} == {Verdict.GOOD}
    assert all(finding.advice == "" for finding in report.findings)
    without_reference = check(Recording(list(good.frames)))
    assert {finding.verdict for finding in without_reference.findings} == {Verdict.GOOD}
    assert "reference" not in names(without_reference, Verdict.GOOD)


FAULTS = {
    "depth scale": [scaled_depth(5.0), scaled_depth(0.2)],
    "colour on depth": [moved_depth(10, 0), moved_depth(-10, 0), moved_depth(0, 10)],  # 20 px of 640
    "frame rate": [dropped(0.4)],
    "intrinsics": [other_camera(1.2), other_camera(0.8), other_camera(1.2, 1.2)],
    "colour to depth time": [late_depth(3), late_depth(-3)],  # 0.1 s at 30 frames per second
}


@pytest.mark.parametrize(("name", "number"), [(name, n) for name, faults in FAULTS.items() for n in range(len(faults))])
def test_the_fault_that_was_put_in_is_named_and_no_other(good: Film, name: str, number: int) -> None:
    faulty: Frames = FAULTS[name][number](list(good.frames))
    report = check(Recording(faulty, good.groundtruth))
    assert names(report) == [name]
    assert advice(report, name)


def test_small_errors_are_noted_with_what_to_write_instead(good: Film) -> None:
    right, late = (check(Recording(list(frames))) for frames in (good.frames, late_depth(1)(list(good.frames))))
    assert "readout" in value(right, "camera file") and "camera file" in names(right, Verdict.GOOD)
    assert names(late) == [] and "camera file" in names(late, Verdict.NOTE)
    (line,) = re.findall(r"depth_delay_ms = (-?\d+)", advice(late, "camera file"))
    assert abs(abs(int(line)) - 1000 / 30) < 12


@pytest.mark.parametrize("factor", [5.0, 0.2])
def test_without_a_reference_the_scale_is_judged_by_what_is_plausible(good: Film, factor: float) -> None:
    report = check(Recording(scaled_depth(factor)(list(good.frames))))
    assert names(report) == ["depth scale"]
    assert f"by {factor:g} " in advice(report, "depth scale")


def test_a_far_scene_is_believed_where_the_reference_agrees(good: Film) -> None:
    poses = good.groundtruth.T_world_cam.clone()
    poses[:, :3, 3] *= 5.0
    report = check(Recording(scaled_depth(5.0)(list(good.frames)), Trajectory(good.groundtruth.timestamps, poses)))
    assert names(report) == []


def test_advice_tells_how_much(good: Film) -> None:
    frames = list(good.frames)
    right = check(Recording(moved_depth(10, 0)(frames)))
    assert right.measured.edges.shift == pytest.approx((10, 0), abs=2)
    late = check(Recording(late_depth(3)(frames)))
    assert late.measured.edges.fine_lag == pytest.approx(3, abs=0.3)
    assert "subtract 0." in advice(late, "colour to depth time")
    early = check(Recording(late_depth(-3)(frames)))
    assert "add 0." in advice(early, "colour to depth time")
    camera = check(Recording(other_camera(1.2)(frames))).measured.calibration
    assert camera is not None
    assert camera.focal_factor == pytest.approx(1 / 1.2, rel=0.03)
    scale = check(Recording(scaled_depth(5.0)(frames), good.groundtruth)).measured.motion
    assert scale is not None
    assert scale.scale == pytest.approx(5.0, rel=0.05)


def test_what_cannot_be_told_is_unknown_and_no_fault(good: Film) -> None:
    wall = [replace(frame, depth=torch.full_like(frame.depth, 2.0)) for frame in good.frames[:20]]
    report = check(Recording(wall))
    assert {"colour on depth", "colour to depth time"} <= set(names(report, Verdict.UNKNOWN))
    still = [replace(good.frames[0], timestamp=index / 30) for index in range(20)]
    report = check(Recording(still))
    assert names(report) == []
    assert {"colour to depth time", "intrinsics"} <= set(names(report, Verdict.UNKNOWN))


def test_bad_images_are_noted(good: Film) -> None:
    frames = list(good.frames[:20])
    blurred = [
        replace(f, gray=torch.from_numpy(cv2.GaussianBlur(f.gray.numpy(), (0, 0), 4.0)), color=None) for f in frames
    ]
    assert "sharpness" in names(check(Recording(blurred)), Verdict.NOTE)
    dark = [replace(frame, gray=frame.gray * 0.1) for frame in frames]
    assert "brightness" in names(check(Recording(dark)), Verdict.NOTE)
    holes = [replace(frame, depth=frame.depth * (torch.rand(frame.depth.shape) < 0.1)) for frame in frames]
    assert "depth" in names(check(Recording(holes)))
    strangers = [
        replace(f, gray=torch.from_numpy(np.random.default_rng(n).uniform(0, 255, f.gray.shape).astype(np.float32)))
        for n, f in enumerate(frames)
    ]
    assert "image motion" in names(check(Recording(strangers)))


def test_a_reference_of_another_time_is_a_fault(good: Film) -> None:
    later = Trajectory(good.groundtruth.timestamps + 1000.0, good.groundtruth.T_world_cam)
    assert names(check(Recording(list(good.frames[:20]), later))) == ["reference"]


def test_frames_that_cannot_be_read_are_counted(good: Film) -> None:
    class Damaged(Recording):
        def read(self, index: int) -> RgbdFrame | BrokenFrame:
            return BrokenFrame(self.timestamps[index], "truncated PNG") if index % 5 == 2 else super().read(index)

    report = check(Damaged(list(good.frames[:20])))
    assert names(report) == ["files"]
    assert value(report, "files").startswith("4 of 20")
    assert "truncated PNG" in advice(report, "files")


def test_the_lists_of_a_folder_are_counted(make_recording, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder = make_recording(frames=12)
    report = check(open_sequence(folder), folder)
    assert value(report, "matched frames").startswith(
        "12 pairs of 12 colour and 12 depth images, depth stamps are +0.005"
    )
    lines = (folder / "depth.txt").read_text().splitlines()
    moved = [line if n % 2 else line.replace(line.split()[0], f"{float(line.split()[0]) + 0.5 / 30:.6f}", 1)
             for n, line in enumerate(lines) if n]  # fmt: skip
    (folder / "depth.txt").write_text("\n".join(moved) + "\n")
    report = check(open_sequence(folder, association_limit_s=0.01), folder)
    assert "matched frames" in names(report)


def test_a_long_recording_costs_no_more_than_a_short_one(good: Film) -> None:
    asked: list[int] = []

    class Long(Recording):
        def read(self, index: int) -> RgbdFrame | BrokenFrame:
            asked.append(index)
            return super().read(index)

    frames = [replace(good.frames[index % 2], timestamp=index / 30) for index in range(400)]
    report = check(Long(frames))
    assert len(asked) == len(set(asked)) == report.measured.sampled == 144
    assert min(asked) == 0
    assert max(asked) == 399


def test_the_picture_shows_the_depth_edges_over_the_frame(good: Film) -> None:
    report = check(Recording(list(good.frames[:20])))
    picture = draw(report.measured)
    assert picture.ndim == 3
    assert picture.dtype == np.uint8
    red = (picture == (230, 40, 40)).all(axis=-1)
    assert red[: picture.shape[0] // 2, : picture.shape[1] // 2].sum() > 100
    empty = draw(check(Recording([replace(f, depth=torch.zeros_like(f.depth)) for f in good.frames[:2]])).measured)
    assert empty.shape == picture.shape


@pytest.mark.parametrize("name", ["redkitchen_400", "tum_fr1_xyz_10", "tum_fr1_desk_9"])
def test_no_false_alarm_on_real_recordings(data_dir: Path, name: str) -> None:
    folder = data_dir / name
    report = check(open_sequence(folder), folder)
    assert names(report) == []


def test_a_real_recording_in_millimetres_read_with_5000_is_noticed(data_dir: Path) -> None:
    assert names(check(open_sequence(data_dir / "redwood_5", depth_scale=5000.0))) == ["depth scale"]
    assert names(check(open_sequence(data_dir / "redwood_5", depth_scale=1000.0))) == []


def test_every_twentieth_frame_overlaps_too_little(data_dir: Path) -> None:
    assert names(check(open_sequence(data_dir / "tum_fr3_cabinet_58"))) == ["image motion"]


def test_the_command_shows_one_screen_and_a_picture(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = data_dir / "redwood_5"
    assert main(["check", str(folder), "--depth-scale", "1000", "--out", str(tmp_path / "good.png")]) == 0
    out = capsys.readouterr().out
    assert "nothing wrong was found" in out
    assert len(out.splitlines()) < 25
    assert cv2.imread(str(tmp_path / "good.png")) is not None
    assert main(["check", str(folder), "--depth-scale", "5000", "--out", str(tmp_path / "bad.png")]) == 1
    assert "faults: depth scale" in capsys.readouterr().out


def test_gaps_are_counted_in_frames_whatever_the_jitter() -> None:
    times = np.arange(100) / 30 + np.random.default_rng(0).uniform(-0.002, 0.002, 100)
    whole = timing(times.tolist())
    assert whole is not None
    assert whole.missing == 0
    assert whole.period_s == pytest.approx(1 / 30, rel=0.03)
    gap = timing(np.delete(times, range(40, 47)).tolist())
    assert gap is not None
    assert gap.missing == 7
    assert gap.longest_s == pytest.approx(8 / 30, abs=0.005)
    assert gap.missing_share == pytest.approx(0.07)
    slow = timing(times[::20].tolist())
    assert slow is not None
    assert slow.missing == 0
    assert timing([0.0, 0.1]) is None


def test_a_pause_is_no_gap_of_a_slow_disk() -> None:
    times = np.arange(100) / 30
    times[50:] += 300.0
    paused = timing(times.tolist())
    assert paused is not None
    assert (paused.missing, paused.pauses_s) == (0, pytest.approx((300.0 + 1 / 30,)))
    slow = timing(np.cumsum([0.0, *[1.0] * 20, 3.0, *[1.0] * 20]).tolist())
    assert slow is not None and (slow.missing, slow.pauses_s) == (2, ())


def test_the_command_says_what_it_read_and_what_is_doubtful_about_it(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(data_dir / "redwood_5"), "--out", str(tmp_path / "a.png")]) == 1
    out, err = capsys.readouterr()
    assert out.startswith(
        "reading TUM RGB-D layout: 5 frames of 640x480, 5000 depth values per metre (the format's default)"
    )
    assert err.startswith("warning: depth scale 5000 makes the first frame's median depth 0.372 m")
    assert "; 1 warning above on how it was read" in out


@pytest.mark.parametrize(("height", "fault"), [(30, True), (60, False)])
def test_small_images_are_not_judged_by_a_pixel(good: Film, height: int, fault: bool) -> None:
    size, s = (height * 4 // 3, height), height / 240
    c = good.frames[0].camera
    camera = Pinhole(width=size[0], height=height, fx=c.fx * s, fy=c.fy * s, cx=(size[0] - 1) / 2, cy=(height - 1) / 2)
    frames = [
        RgbdFrame(
            frame.timestamp,
            torch.from_numpy(cv2.resize(frame.gray.numpy(), size, interpolation=cv2.INTER_AREA)),
            torch.from_numpy(cv2.resize(frame.depth.numpy(), size, interpolation=cv2.INTER_NEAREST)),
            camera,
        )
        for frame in good.frames
    ]
    found = {finding.name: finding for finding in check(Recording(frames)).findings}
    assert (found["size, camera"].verdict is Verdict.FAULT) == fault
    assert found["colour on depth"].verdict is Verdict.UNKNOWN


def test_edges_width_grows_with_blur() -> None:
    step = np.zeros((100, 100), np.float32)
    step[:, 50:] = 200.0
    widths = [edge_width(cv2.GaussianBlur(step, (0, 0), sigma)) for sigma in (0.8, 1.5, 2.5)]
    for width, sigma in zip(widths, (0.8, 1.5, 2.5), strict=True):
        assert width == pytest.approx(np.sqrt(2 * np.pi) * sigma, rel=0.45)  # range over the slope of a blurred step
    assert np.isnan(edge_width(np.full((50, 50), 7.0, np.float32)))
