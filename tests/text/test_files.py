"""Texts from outside: one sentence for whatever may be wrong with them, with the file and the line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzz.promise import limits

from idrgbdo_torch.config import Config
from idrgbdo_torch.datasets.calibration import find_calibration
from idrgbdo_torch.datasets.camera_files import camera_values
from idrgbdo_torch.datasets.poses import log_poses, matrices
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.text import configfile
from idrgbdo_torch.text.files import read_bytes, read_json, read_table, read_text, read_toml
from idrgbdo_torch.trajectory import read_tum

Read = Callable[[Path], object]
READERS: dict[str, Read] = {
    "text": read_text,
    "json": read_json,
    "toml": read_toml,
    "table": lambda path: read_table(path, ("timestamp",)),
    "camera": camera_values,
    "settings": lambda path: configfile.load(path, Config()),
    "trajectory": read_tum,
    "matrices": matrices,
    "log": log_poses,
}


def made(path: Path, what: str) -> Path:
    if what == "a folder":
        path.mkdir()
    elif what == "a pipe":
        os.mkfifo(path)
    elif what == "a device":
        path.symlink_to("/dev/zero")
    elif what == "a link to nothing":
        path.symlink_to("gone")
    elif what == "a link to itself":
        path.symlink_to(path.name)
    elif what == "no text":
        path.write_bytes(b"\x89PNG\xff\xfe\x81" * 20)
    elif what == "a name with NUL":
        return path.with_name("a\0b.txt")
    elif what == "a name too long":
        return path.with_name("n" * 300)
    else:
        path.touch()
        os.truncate(path, 1 << 40)
    return path


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "what",
    [
        *("a folder", "a pipe", "a device", "a link to nothing", "a link to itself", "no text", "a name with NUL"),
        *("a name too long", "a terabyte"),
    ],
)
def test_what_is_no_text_file_is_one_sentence(reader: str, what: str, tmp_path: Path) -> None:
    path = made(tmp_path / "a.txt", what)
    with limits(10), pytest.raises(IdRgbdoError, match="cannot read") as caught:
        READERS[reader](path)
    assert path.name[:20] in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("data", ["", "[" * 100_000, "{" * 3000, "9" * 5000, '{"a": ' * 5000, "nul", "{,}"])
def test_json_that_is_none(data: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(data)
    with limits(10), pytest.raises(IdRgbdoError, match=r"a\.json: expected JSON \(.*\); correct it") as caught:
        read_json(tmp_path / "a.json")
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("a = " + "[" * 5000, "is not TOML: nested too deep"),
        ("a = " + "9" * 5000, "is not TOML: Exceeds the limit"),
        ("a." * 200_000 + "b = 1", "no key of line 1"),
        ("\n\nseed = = 1", "line 3"),
        ("seed = " + "9" * 400, r"a\.toml: seed: expected a whole number at least 0, got 9+"),
        ("seed = 0x" + "f" * 5000, "got something long"),
        ("[tracking]\nsigma_turn = inf", "sigma_turn: expected a number above 0, got inf"),
        ("[tracking]\nsigma_turn = 1e308", "sigma_turn: expected a number above 0, got 1e"),
        ("[tracking]\nsigma_turn = " + "9" * 400, "sigma_turn: expected a number above 0, got 9"),
        ("k" * 100_000 + " = 1", r"no such key"),
        ("noise = " + "[" * 60 + "]" * 60, "expected a table, got"),
    ],
)
def test_settings_that_are_none(data: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(data)
    with limits(10), pytest.raises(IdRgbdoError, match=said) as caught:
        configfile.load(tmp_path / "a.toml", Config())
    assert len(str(caught.value)) < 700


NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "0", "-5", "9" * 400, "²")
CAMERAS = {
    "camera.toml": "fx = {fx}\nfy = {fy}\ncx = {cx}\ncy = 23.5\nk1 = {k1}\np2 = {p2}\nk6 = {k6}\nfps = {fps}\n"
    "depth_scale = {scale}\n",
    "camera.yaml": "fx: {fx}\nfy: {fy}\ncx: {cx}\ncy: 23.5\ndist_coeffs: [{k1}, 0, 0, {p2}, 0, 0, 0, {k6}]\n",
    "camera.json": '{{"fx": {fx}, "fy": {fy}, "ppx": {cx}, "ppy": 23.5, "coeffs": [{k1}, 0, 0, {p2}, 0]}}',
    "open3d.json": '{{"width": 64, "height": 48, "intrinsic_matrix": [{fx}, 0, 0, 0, {fy}, 0, {cx}, 23.5, 1]}}',
    "calibration.txt": "{fx} {fy} {cx} 23.5 {k1} 0 0 {p2} 0 0 0 {k6}",
    "two.toml": "fx = 60\nfy = 60\ncx = 31.5\ncy = 23.5\n[depth]\nfx = {fx}\nfy = {fy}\ncx = {cx}\ncy = 23.5\n",
}
GOOD = {
    "fx": "60.0",
    "fy": "60.0",
    "cx": "31.5",
    "k1": "0.1",
    "p2": "0.01",
    "k6": "0.1",
    "fps": "30.0",
    "scale": "1000.0",
}
MAY_BE = {"0": ("cx", "k1", "p2", "k6"), "-5": ("cx", "k1", "p2", "k6")}


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("name", CAMERAS)
def test_no_camera_has_such_a_number(name: str, number: str, tmp_path: Path) -> None:
    """Whatever the dialect, the number is refused where it is read, with the file's name."""
    path = tmp_path / name
    path.write_text(CAMERAS[name].format(**GOOD))
    find_calibration(tmp_path, path)
    spelt = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}.get(number, number) if ".json" in name else number
    for key in GOOD:
        if f"{{{key}}}" not in CAMERAS[name] or key in MAY_BE.get(number, ()):
            continue
        path.write_text(CAMERAS[name].format(**{**GOOD, key: spelt}), encoding="utf-8")
        with limits(10), pytest.raises(IdRgbdoError) as caught:
            find_calibration(tmp_path, path)
        assert name in str(caught.value) and len(str(caught.value)) < 700 and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "row",
    [
        *("nan 0 0 0 0 0 0 1", "inf 0 0 0 0 0 0 1", "1e308 0 0 0 0 0 0 1", "9" * 400 + " 0 0 0 0 0 0 1"),
        *("3 1e308 0 0 0 0 0 1", "3 inf 0 0 0 0 0 1", "3 0 0 0 inf 0 0 1", "² 0 0 0 0 0 0 1"),
    ],
)
def test_no_pose_has_such_a_number(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(f"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n{row}\n")
    with pytest.raises(IdRgbdoError, match=r"a\.txt, line 3: expected"):
        read_tum(tmp_path / "a.txt")


def test_words_among_matrices_are_named_with_their_line(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 one 0\n0 0 0 1\n")
    with pytest.raises(IdRgbdoError, match=r"a\.txt, line 3: expected 16 numbers a pose .*'one'"):
        matrices(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("timestamp,status\n1,ok\n2\n", "expected 2 cells in line 3"),
        ("timestamp,status\n1,ok,3\n", "expected 2 cells in line 2"),
        ("time,status\n1,ok\n", "it has no column timestamp"),
        ("", "it has no column timestamp, status"),
        ("timestamp,status\n1," + "x" * 200_000 + "\n", "line 2: field larger"),
    ],
)
def test_tables_of_other_rows(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(IdRgbdoError, match=said):
        read_table(tmp_path / "a.csv", ("timestamp", "status"))


def test_long_calibrations_take_no_long_time(tmp_path: Path) -> None:
    for text in ("a: [" + "[" * 500_000, "a: [1,\n" * 150_000, "a: 1\n" * 200_000, "a: [" + "1, [" * 100_000):
        (tmp_path / "a.yaml").write_text(text)
        with limits(10), pytest.raises(IdRgbdoError, match=r"a\.yaml"):
            find_calibration(tmp_path, tmp_path / "a.yaml")


def test_files_are_read_in_one_piece(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(range(256)) * 9)
    assert read_bytes(tmp_path / "a", 1 << 20) == bytes(range(256)) * 9
    with pytest.raises(IdRgbdoError, match=r"it has 0\.0 MB, more than 0 MB"):
        read_bytes(tmp_path / "a", 100)
