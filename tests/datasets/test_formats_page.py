"""docs/formats.md: the format that the page adds is a format, in fifty lines."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import format_writers
import numpy as np
import pytest
import torch
from rendered import Film

from idrgbdo_torch import IdRgbdo, datasets
from idrgbdo_torch.datasets import guess, open_sequence
from idrgbdo_torch.datasets.formats import FORMATS, Format
from idrgbdo_torch.datasets.recording import Recording
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.evaluation import evaluate
from idrgbdo_torch.odometry import Status, run

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
(CODE,) = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
NAME = "idrgbdo_torch.datasets.bundlefusion"


@pytest.fixture
def bundlefusion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The page's file as a module of the package, in FORMATS before `folder`."""
    (tmp_path / "bundlefusion.py").write_text(CODE)
    spec = importlib.util.spec_from_file_location(NAME, tmp_path / "bundlefusion.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, NAME, module)
    spec.loader.exec_module(module)
    (line,) = re.findall(r'^    "bundlefusion": (.*),$', PAGE, flags=re.MULTILINE)
    added = eval(line, {"Format": Format, "bundlefusion": module})
    before = dict(FORMATS)
    FORMATS.clear()
    for name, known in before.items():
        FORMATS.update({"bundlefusion": added} if name == "folder" else {})
        FORMATS[name] = known
    yield module
    FORMATS.clear()
    FORMATS.update(before)


def write(film: Film, folder: Path) -> None:
    for index in range(len(film.frames)):
        name = f"frame-{index:06}"
        format_writers.save(folder / f"{name}.color.jpg", format_writers.color(film, index))
        format_writers.save(folder / f"{name}.depth.png", format_writers.depth(film, index, 2000))
        (folder / f"{name}.pose.txt").write_text(format_writers.matrix(format_writers.pose(film, index)))
    c = film.frames[0].camera
    K = f"{c.fx} 0 {c.cx} 0 0 {c.fy} {c.cy} 0 0 0 1 0 0 0 0 1"
    lines = ("m_versionNumber = 4", "m_sensorName = StructureSensor", "m_depthShift = 2000")
    cameras = (f"m_calibrationColorIntrinsic = {K} ", f"m_calibrationDepthIntrinsic = {K} ")
    (folder / "info.txt").write_text("\n".join([*lines, *cameras]) + "\n")


def test_the_pages_format_is_recognised_and_its_film_tracked(
    desk: Film, tmp_path: Path, bundlefusion: ModuleType
) -> None:
    film = Film(desk.frames[:12], desk.groundtruth.at(torch.arange(12)))
    write(film, tmp_path / "apt0")
    assert guess(tmp_path / "apt0") == "bundlefusion"
    sequence = open_sequence(tmp_path / "apt0")
    assert sequence.recognised == "BundleFusion: 12 frames of 320x240, 2000 depth values per metre, with ground truth"
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(
        sequence.groundtruth.T_world_cam.numpy(), film.groundtruth.T_world_cam.numpy(), atol=1e-9
    )
    done = run(IdRgbdo(), sequence)
    assert Status.LOST not in done.statuses
    assert evaluate(done.trajectory(), sequence.groundtruth).ate.rmse_m < 0.004
    (tmp_path / "apt0" / "info.txt").write_text("m_depthShift = 1000\n")
    with pytest.raises(IdRgbdoError, match=r"info\.txt: expected the two intrinsics and m_depthShift"):
        open_sequence(tmp_path / "apt0")


def test_the_page_keeps_its_word() -> None:
    """Fifty lines of code; all fields of a Recording explained, and only helpers named that there are."""
    code = [line for line in CODE.splitlines() if line.strip()]
    assert len(code) <= 50
    rows = re.findall(r"^\| (`.*?`) \|", PAGE, flags=re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    fields = set(Recording.__dataclass_fields__)
    assert fields <= named
    files = Path(datasets.__file__).parent.glob("*.py")
    defined = {name for file in files for name in re.findall(r"^def (\w+)", file.read_text(), flags=re.MULTILINE)}
    assert named - fields - {"read_text"} <= defined
