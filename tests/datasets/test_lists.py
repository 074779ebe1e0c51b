"""Lists of images in the dialects that people's programs write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.text.clock import unit_of
from idrgbdo_torch.text.files import read_text

Make = Callable[..., Path]
START = 1_612_345_678
FRAMES = 12
Line = Callable[[float, str, str], str]  # of the time (s), the kind and the name of the file


def rewrite(folder: Path, line: Line, head: str = "", encode: Callable[[str], bytes] = str.encode) -> Path:
    """The lists of a tiny recording, written anew; depth is 6 ms late. Its files become 0000.png and so on."""
    for kind, late in (("rgb", 0.0), ("depth", 0.006)):
        lines = []
        for k, path in enumerate(sorted((folder / kind).iterdir())):
            new = path.rename(path.with_name(f"{k:04}.png"))
            lines.append(line(START + k / 30 + late, kind, new.name))
        (folder / f"{kind}.txt").write_bytes(encode(head + "\n".join(lines) + "\n"))
    return folder


def plain(t: float, kind: str, name: str) -> str:
    return f"{t:.6f} {kind}/{name}"


DIALECTS: dict[str, dict[str, object]] = {
    "byte order mark": {"line": plain, "encode": lambda text: b"\xef\xbb\xbf" + text.encode()},
    "byte order mark and comment": {"line": plain, "head": "# colour\n", "encode": lambda t: t.encode("utf-8-sig")},
    "carriage returns": {"line": plain, "encode": lambda text: text.replace("\n", "\r\n").encode()},
    "UTF-16 of PowerShell": {"line": plain, "encode": lambda text: text.replace("\n", "\r\n").encode("utf-16")},
    "UTF-16 without mark": {"line": plain, "encode": lambda text: text.encode("utf-16-le")},
    "UTF-16, big end first": {"line": plain, "encode": lambda text: text.encode("utf-16-be")},
    "backslashes": {"line": lambda t, kind, name: f"{t:.6f} {kind}\\{name}"},
    "a path of Windows": {"line": lambda t, kind, name: f"{t:.6f} D:\\my takes\\rec\\{kind}\\{name}"},
    "a path of another machine": {"line": lambda t, kind, name: f"{t:.6f} /home/me/rec/{kind}/{name}"},
    "commas and header": {"line": lambda t, kind, name: f"{t:.6f},{kind}/{name}", "head": "#timestamp,filename\n"},
    "commas and blanks": {"line": lambda t, kind, name: f"{t:.6f}, {kind}/{name},"},
    "semicolons and decimal commas": {"line": lambda t, kind, name: f"{t:.6f};{kind}/{name}".replace(".", ",", 1)},
    "decimal commas": {"line": lambda t, kind, name: plain(t, kind, name).replace(".", ",", 1)},
    "tabs": {"line": lambda t, kind, name: f"{t:.6f}\t{kind}/{name}"},
    "header without comment": {"line": plain, "head": "timestamp filename\n"},
    "without folder": {"line": lambda t, kind, name: f"{t:.6f} {name}"},
    "quoted": {"line": lambda t, kind, name: f'{t:.6f},"{kind}/{name}"'},
    "milliseconds": {"line": lambda t, kind, name: f"{1e3 * t:.0f} {kind}/{name}"},
    "milliseconds with decimals": {"line": lambda t, kind, name: f"{1e3 * t:.3f} {kind}/{name}"},
    "microseconds": {"line": lambda t, kind, name: f"{1e6 * t:.0f} {kind}/{name}"},
    "nanoseconds": {"line": lambda t, kind, name: f"{round(1e6 * t) * 1000} {kind}/{name}"},
    "nanoseconds and commas": {"line": lambda t, kind, name: f"{round(1e6 * t) * 1000},{kind}/{name}"},
    "exponents": {"line": lambda t, kind, name: f"{1e9 * t:.17e} {kind}/{name}"},
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_says_the_same(make_recording: Make, dialect: str) -> None:
    folder = rewrite(make_recording(frames=FRAMES, groundtruth=False), **DIALECTS[dialect])  # type: ignore[arg-type]
    sequence = open_sequence(folder)
    assert sequence.timestamps == pytest.approx([START + k / 30 for k in range(FRAMES)], abs=6e-4)
    assert all(isinstance(frame, RgbdFrame) for frame in sequence)
    assert sequence.warnings == []
    unit = next((u for u in ("milliseconds", "microseconds", "nanoseconds") if u in dialect), None)
    unit = "nanoseconds" if dialect == "exponents" else unit
    assert sequence.recognised.startswith("TUM RGB-D layout" + (f", times in {unit}: " if unit else ": "))


def test_names_with_blanks(make_recording: Make) -> None:
    folder = make_recording(frames=3, groundtruth=False)
    pairs = []
    for kind in ("rgb", "depth"):
        lines = []
        for k, path in enumerate(sorted((folder / kind).iterdir())):
            path.rename(path.with_name(f"img {k} a.png"))
            lines.append(f"{k / 30:.6f} {kind}/img {k} a.png")
        (folder / f"{kind}.txt").write_text("\n".join(lines))
        pairs.append(lines)
    assert all(isinstance(frame, RgbdFrame) for frame in open_sequence(folder))
    (folder / "associations.txt").write_text("\n".join(f"{a} {b}" for a, b in zip(*pairs, strict=True)))
    sequence = open_sequence(folder, associations=folder / "associations.txt")
    assert [type(frame) for frame in sequence] == [RgbdFrame] * 3


def test_each_column_of_associations_has_its_unit(make_recording: Make) -> None:
    folder = rewrite(make_recording(frames=FRAMES, groundtruth=False), plain)
    lines = [
        f"{START * 1000 + round(k * 1000 / 30)} rgb/{k:04}.png {START + k / 30:.6f} depth/{k:04}.png"
        for k in range(FRAMES)
    ]
    (folder / "pairs.csv").write_text("\n".join(lines).replace(" ", ","))
    sequence = open_sequence(folder, associations=folder / "pairs.csv")
    assert sequence.timestamps == pytest.approx([START + k / 30 for k in range(FRAMES)], abs=6e-4)
    assert "times in milliseconds" in sequence.recognised


def test_a_few_repeated_times_are_counted(make_recording: Make) -> None:
    folder = rewrite(make_recording(frames=FRAMES, groundtruth=False), plain)
    lines = (folder / "rgb.txt").read_text().splitlines()
    lines[5] = lines[4].split()[0] + " rgb/0005.png"
    (folder / "rgb.txt").write_text("\n".join(lines))
    sequence = open_sequence(folder)
    assert len(sequence) == FRAMES - 1
    (warning,) = sequence.warnings
    assert "rgb.txt: 1 of 12 lines repeat a time, first line 6; the first of equal times is taken" in warning


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (lambda t, kind, name: f"{t:.1f} {kind}/{name}", r"rgb\.txt: 7 of 12 lines repeat a time, first line 2"),
        (lambda t, kind, name: f"0.000000 {kind}/{name}", r"rgb\.txt: 11 of 12 lines repeat a time, first line 2"),
        (
            lambda t, kind, name: f"{t - (3600 if name >= '0006' else 0):.6f} {kind}/{name}",
            r"rgb\.txt: the times run backwards at line 7, by 3599\.97 s, while the names of the images go on",
        ),
    ],
)
def test_times_that_are_no_clock_say_to_number_the_frames(make_recording: Make, line: Line, complaint: str) -> None:
    folder = rewrite(make_recording(frames=FRAMES, groundtruth=False), line)
    with pytest.raises(IdRgbdoError, match=complaint + ".* number the frames instead: remove or rename the lists"):
        open_sequence(folder)
    for name in ("rgb.txt", "depth.txt"):  # as the message advises
        (folder / name).unlink()
    (folder / "camera.toml").write_text("fx=60\nfy=60\ncx=31.5\ncy=23.5\ndepth_scale=5000\nfps=30\n")
    assert open_sequence(folder).timestamps == pytest.approx([k / 30 for k in range(FRAMES)])


def test_a_list_that_is_only_not_sorted_is_no_fault_and_a_small_step_back_is_said(make_recording: Make) -> None:
    folder = rewrite(make_recording(frames=FRAMES, groundtruth=False), plain)
    lines = (folder / "rgb.txt").read_text().splitlines()
    (folder / "rgb.txt").write_text("\n".join(lines[::-1]))
    assert (open_sequence(folder).warnings, len(open_sequence(folder))) == ([], FRAMES)
    times = [line.split()[0] for line in lines]
    times[4], times[5] = times[5], times[4]
    (folder / "rgb.txt").write_text("\n".join(f"{t} rgb/{k:04}.png" for k, t in enumerate(times)))
    (warning,) = open_sequence(folder).warnings
    assert "run backwards at line 6, by 0.03333" in warning


@pytest.mark.parametrize(("step", "guess"), [(1, "numbers of frames"), (33, "milliseconds")])
def test_whole_numbers_that_are_hardly_seconds_are_said(make_recording: Make, step: int, guess: str) -> None:
    folder = rewrite(
        make_recording(frames=FRAMES, groundtruth=False), lambda t, kind, name: f"{step * int(name[:4])} {kind}/{name}"
    )
    sequence = open_sequence(folder)
    assert sequence.timestamps == [step * k for k in range(FRAMES)]
    said = f"whole numbers {step} apart and are taken as seconds; if they are {guess}"
    assert all(said in warning for warning in sequence.warnings)
    assert len(sequence.warnings) == 2


def test_missing_files_are_said_at_the_start(make_recording: Make) -> None:
    folder = make_recording(frames=50)
    for kind, kept in (("rgb", range(0, 50)), ("depth", range(40, 50))):  # more than are tried one after the other
        for k, path in enumerate(sorted((folder / kind).iterdir())):
            if k not in kept:
                path.unlink()
    sequence = open_sequence(folder)
    assert isinstance(sequence.read(45), RgbdFrame)
    (warning,) = sequence.warnings
    assert warning.startswith("40 of 100 listed image files do not exist, so that 40 of 50 frames are lost; the first")
    assert "depth/100.005000.png" in warning


def test_many_images_without_partner_in_time_are_said(make_recording: Make) -> None:
    folder = rewrite(
        make_recording(frames=20, groundtruth=False),
        lambda t, kind, name: plain(t + (kind == "depth" and int(name[:4]) % 3 == 1) / 60, kind, name),
    )
    sequence = open_sequence(folder)
    (warning,) = sequence.warnings
    assert "20 colour and 20 depth images make only" in warning


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        ([1612345678.5, 1612345678.53], "seconds"),
        ([0.0, 2.5, 5.0], "seconds"),
        ([1612345678500.0, 1612345678533.0], "milliseconds"),
        ([1612345678500.0, 1612345681000.0], "milliseconds"),  # a time lapse
        ([1612345678500000.0, 1612345678533333.0], "microseconds"),
        ([1612345678500000000, 1612345678533333333], "nanoseconds"),
        ([1612345678500000000], "nanoseconds"),
        (
            [3_600_000_000_000, 3_600_033_333_333, 3_600_066_666_666],
            "nanoseconds",
        ),  # an hour after a start
        ([3_600_000_000, 3_600_033_333, 3_600_066_666], "microseconds"),
        ([], "seconds"),
        ([10**14 + k for k in range(5)], None),  # ids
    ],
)
def test_the_unit_of_times(stamps: list[float], unit: str | None) -> None:
    assert unit_of(stamps) == unit


def test_bytes_that_are_no_text_are_an_error(make_recording: Make, tmp_path: Path) -> None:
    folder = make_recording()
    (folder / "rgb.txt").write_bytes(b"\x89PNG\xff\xfe\x81" * 20)
    with pytest.raises(IdRgbdoError, match=r"cannot read '.*rgb\.txt'"):
        open_sequence(folder)
    (tmp_path / "empty.txt").write_bytes(b"")
    assert read_text(tmp_path / "empty.txt") == ""
