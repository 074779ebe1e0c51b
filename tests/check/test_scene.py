"""What is filmed and from where: depth of another view, a cut, a camera at rest, things that move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from faults import Recording, covered, cut_to, seen_by
from rendered import SMALL, Film, film

from idrgbdo_torch.check import Report, Verdict, check
from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.datasets import open_sequence

SCENE = {"cut", "still camera", "moving things"}


def noticed(report: Report) -> dict[str, str]:
    """Rows on the scene, and what they measured."""
    assert all(finding.verdict is Verdict.NOTE for finding in report.findings if finding.name in SCENE)
    return {finding.name: finding.value for finding in report.findings if finding.name in SCENE}


def test_depth_of_a_wider_view_is_named_with_the_block_to_write(desk: Film) -> None:
    wider = film(replace(SMALL, fx=SMALL.fx / 1.5, fy=SMALL.fy / 1.5))
    report = check(Recording(seen_by(list(wider.frames))(list(desk.frames))))
    (fault,) = report.faults
    assert fault.name == "colour on depth"
    assert "not registered" in fault.advice
    assert "[depth]" in fault.advice.splitlines()
    block = dict(line.split(" = ") for line in fault.advice.splitlines() if line[:2] in {"fx", "fy", "cx", "cy"})
    assert float(block["fx"]) == pytest.approx(SMALL.fx / 1.5, rel=0.05)
    assert float(block["fy"]) == pytest.approx(SMALL.fy / 1.5, rel=0.05)
    assert float(block["cx"]) == pytest.approx(SMALL.cx, abs=8)
    assert float(block["cy"]) == pytest.approx(SMALL.cy, abs=8)


def test_a_real_robot_with_unregistered_depth_is_named(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = data_dir / "d435_unregistered_60"
    camera = ["--camera", str(folder / "camera.toml"), "--out", str(tmp_path / "check.png")]
    assert main(["check", str(folder), *camera]) == 1
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert "faults: colour on depth" in lines
    (fx,) = (float(line[5:]) for line in lines[lines.index("[depth]") :] if line.startswith("fx = "))
    assert fx == pytest.approx(385.3, rel=0.05)


def test_the_same_with_its_block_is_no_fault(data_dir: Path) -> None:
    folder = data_dir / "d435_unregistered_60"
    assert check(open_sequence(folder, camera=folder / "camera_registered.toml")).faults == []


@pytest.mark.parametrize("name", ["kinect_ship_201", "azure_arm_61", "iphone_door_40", "redkitchen_400"])
def test_real_recordings_have_no_fault_and_no_cut_and_nothing_moves(data_dir: Path, name: str) -> None:
    report = check(open_sequence(data_dir / name))
    assert report.faults == []
    assert set(noticed(report)) <= {"still camera"}


def test_a_cut_is_noticed(desk: Film) -> None:
    other = film(replace(SMALL, kind="structure_texture"))
    report = check(Recording(cut_to(list(other.frames), 15)(list(desk.frames))))
    assert noticed(report)["cut"].startswith("frame 15 ")


def test_a_still_camera_is_noticed(desk: Film) -> None:
    still = [replace(desk.frames[0], timestamp=frame.timestamp) for frame in desk.frames]
    assert set(noticed(check(Recording(still)))) == {"still camera"}


def test_a_moving_object_over_half_the_view_is_noticed(desk: Film) -> None:
    report = check(Recording(covered(0.55, 3)(list(desk.frames))))
    assert set(noticed(report)) == {"moving things"}


def test_a_good_film_is_one_still_scene(desk: Film) -> None:
    assert noticed(check(Recording(list(desk.frames)))) == {}
