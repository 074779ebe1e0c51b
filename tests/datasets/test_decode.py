"""Decoding gives the bits that OpenCV gives, sooner; what it does not know goes to OpenCV, or is refused as ever."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from png_writer import GRAY, GRAY_ALPHA, PALETTE, RGB, RGBA, SIGNATURE, chunk, header, png
from rendered import Film

from idrgbdo_torch.datasets import jpeg
from idrgbdo_torch.datasets import png as png_file
from idrgbdo_torch.datasets.images import decode_color, decode_depth, read_depth
from idrgbdo_torch.datasets.jpeg import decode_jpeg
from idrgbdo_torch.datasets.pixels import gray_and_rgb, metres_of_16_bits
from idrgbdo_torch.datasets.png import decode_png
from idrgbdo_torch.errors import IdRgbdoError

AS_COLOR = cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION
FAST = {"depth": (16, GRAY), "colour": (8, RGB), "colour with alpha": (8, RGBA)}
FILTERS = [(0,), (1,), (2,), (3,), (4,), (0, 1, 2, 3, 4, 3, 1, 4, 2)]
SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (19, 33)]


def by_opencv(data: bytes, flags: int) -> NDArray[np.generic]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    assert image is not None
    return image


def values(size: tuple[int, int], bits: int, kind: int) -> NDArray[np.int64]:
    channels = {GRAY: (), PALETTE: (), GRAY_ALPHA: (2,), RGB: (3,), RGBA: (4,)}[kind]
    return np.random.default_rng(size).integers(0, 2**bits, (*size, *channels))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("filters", FILTERS)
@pytest.mark.parametrize("name", FAST)
def test_every_filter_of_png(name: str, filters: tuple[int, ...], size: tuple[int, int]) -> None:
    bits, kind = FAST[name]
    stored = values(size, bits, kind)
    data = png(stored, bits, kind, filters, parts=3)
    image = decode_png(data, color=bits == 8)
    assert image is not None
    np.testing.assert_array_equal(image, stored[..., 2::-1] if bits == 8 else stored)
    np.testing.assert_array_equal(image, by_opencv(data, AS_COLOR if bits == 8 else cv2.IMREAD_UNCHANGED))


COLORS = chunk(b"PLTE", bytes(range(48)))
NOT_FAST = {
    **{f"gray of {bits} bits": png(values((9, 13), bits, GRAY), bits, GRAY, (2, 3)) for bits in (1, 2, 4, 8)},
    "gray with alpha": png(values((9, 13), 8, GRAY_ALPHA), 8, GRAY_ALPHA, (4,)),
    "gray of 16 bits with alpha": png(values((9, 13), 16, GRAY_ALPHA), 16, GRAY_ALPHA, (4,)),
    "colour of 16 bits": png(values((9, 13), 16, RGB), 16, RGB, (4,)),
    "colour of 16 bits with alpha": png(values((9, 13), 16, RGBA), 16, RGBA, (3,)),
    "palette": png(values((9, 13), 4, PALETTE), 4, PALETTE, (0,), COLORS),
    "a transparent gray": png(values((9, 13), 16, GRAY), 16, GRAY, (1,), chunk(b"tRNS", b"\0\7")),
    "a transparent colour": png(values((9, 13), 8, RGB), 8, RGB, (1,), chunk(b"tRNS", b"\0\1\0\2\0\3")),
    "something new": png(values((9, 13), 8, RGB), 8, RGB, (1,), chunk(b"neWw", b"?")),
}


@pytest.mark.parametrize("name", NOT_FAST)
def test_other_kinds_of_png_are_left_to_opencv(name: str) -> None:
    data = NOT_FAST[name]
    assert decode_png(data, color=True) is None
    assert decode_png(data, color=False) is None
    np.testing.assert_array_equal(decode_color(data, "here"), by_opencv(data, AS_COLOR))


def test_depth_in_colour_and_colour_in_depth_are_left_to_opencv() -> None:
    depth, color = png(values((5, 6), 16, GRAY), 16, GRAY), png(values((5, 6), 8, RGB), 8, RGB)
    assert decode_png(depth, color=True) is None
    assert decode_png(color, color=False) is None
    np.testing.assert_array_equal(decode_color(depth, "here"), by_opencv(depth, AS_COLOR))
    with pytest.raises(IdRgbdoError, match="check that colour and depth are not mixed up"):
        decode_depth(color, "here")


def interlaced() -> tuple[bytes, NDArray[np.int64]]:
    """A file in seven passes: every eighth pixel first."""
    stored = values((8, 8), 16, GRAY)
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    rows = b"".join(
        b"\0" + row.astype(">u2").tobytes() for v, u, down, right in passes for row in stored[v::down, u::right]
    )
    data = SIGNATURE + header(8, 8, 16, GRAY, 1) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND")
    return data, stored


def test_interlaced_png_is_left_to_opencv() -> None:
    data, stored = interlaced()
    assert decode_png(data, color=False) is None
    np.testing.assert_array_equal(decode_depth(data, "here"), stored)


def test_remarks_in_a_png_change_nothing() -> None:
    remarks = {
        b"gAMA": struct.pack(">I", 100_000), b"sBIT": b"\5\6\5", b"tEXt": b"Title\0a", b"pHYs": b"\0\0\0\1\0\0\0\2\0",
        b"sRGB": b"\1", b"tIME": b"\x07\xe8\1\1\0\0\0", b"cHRM": struct.pack(">8I", *range(30_000, 38_000, 1000)),
        b"eXIf": b"MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1\0\6\0\0\0\0\0\0",  # turned by a quarter
    }  # fmt: skip
    stored = values((9, 13), 8, RGB)
    for name, content in remarks.items():
        data = png(stored, 8, RGB, (1, 4), chunk(name, content))
        image = decode_png(data, color=True)
        assert image is not None, name
        np.testing.assert_array_equal(image, by_opencv(data, AS_COLOR), str(name))


def pixels_of(data: bytes) -> tuple[int, int]:
    """Where the content of the only IDAT chunk begins and ends."""
    begin = data.index(b"IDAT") + 4
    return begin, begin + struct.unpack(">I", data[begin - 8 : begin - 4])[0]


def with_pixels(data: bytes, pixels: bytes, head: bytes | None = None) -> bytes:
    """The file with other compressed pixels, and another header, checksums right."""
    begin, _ = pixels_of(data)
    return (data[: begin - 8] if head is None else SIGNATURE + head) + chunk(b"IDAT", pixels) + chunk(b"IEND")


def test_a_damaged_png_is_never_decoded() -> None:
    whole = png(values((19, 33), 16, GRAY), 16, GRAY, (4, 3))
    rng = np.random.default_rng(1)
    for length in rng.integers(0, len(whole), 60):
        assert decode_png(whole[:length], color=False) is None
        with pytest.raises(IdRgbdoError):
            decode_depth(whole[:length], "here")
    for at, bit in zip(rng.integers(0, len(whole), 200), rng.integers(0, 8, 200), strict=True):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << bit
        assert decode_png(bytes(flipped), color=False) is None, f"bit {bit} of byte {at}"


def test_right_checksums_around_wrong_pixels_are_left_to_opencv() -> None:
    stored = values((19, 33), 16, GRAY)
    whole = png(stored, 16, GRAY, (4, 3))
    rows = zlib.decompress(whole[slice(*pixels_of(whole))])
    pixels = zlib.compress(rows)
    wrong = {
        "a filter that does not exist": zlib.compress(b"\5" + rows[1:]),
        "a row too few": zlib.compress(rows[:-67]),
        "a row too many": zlib.compress(rows + rows[-67:]),
        "a wrong sum": pixels[:-1] + bytes([pixels[-1] ^ 1]),
        "an early end": pixels[: len(pixels) // 2],
        "no pixels": b"",
        "noise": bytes(np.random.default_rng(2).integers(0, 256, 900, dtype=np.uint8)),
    }
    for name, content in wrong.items():
        data = with_pixels(whole, content)
        assert decode_png(data, color=False) is None, name
        expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if expected is None:
            with pytest.raises(IdRgbdoError, match="that OpenCV can decode"):
                decode_depth(data, "here")
        else:
            np.testing.assert_array_equal(decode_depth(data, "here"), expected, name)
    for width, height in ((2**31 - 1, 2**31 - 1), (100_000, 100_000), (0, 19), (33, 0)):
        assert decode_png(with_pixels(whole, pixels, header(width, height, 16, GRAY)), color=False) is None


def test_pixels_in_two_places_are_left_to_opencv() -> None:
    whole = png(values((19, 33), 16, GRAY), 16, GRAY, (1,))
    begin, end = pixels_of(whole)
    middle = (begin + end) // 2
    parts = (
        chunk(b"IDAT", whole[begin:middle]),
        chunk(b"tEXt", b"a\0b"),
        chunk(b"IDAT", whole[middle:end]),
        chunk(b"IEND"),
    )
    assert decode_png(whole[: begin - 8] + b"".join(parts), color=False) is None


def test_rendered_frames(desk: Film) -> None:
    for frame in desk.frames[::10]:
        assert frame.color is not None
        bgr, depth = frame.color.numpy()[..., ::-1], (frame.depth.numpy() * 5000).astype(np.uint16)
        data = {kind: cv2.imencode(suffix, image)[1].tobytes() for kind, suffix, image in (
            ("rgb", ".png", bgr), ("depth", ".png", depth), ("jpeg", ".jpg", bgr)
        )}  # fmt: skip
        decoded = decode_png(data["rgb"], color=True), decode_png(data["depth"], color=False)
        np.testing.assert_array_equal(decoded[0], bgr)
        np.testing.assert_array_equal(decoded[1], depth)
        np.testing.assert_array_equal(decode_jpeg(data["jpeg"]), by_opencv(data["jpeg"], AS_COLOR))


def test_real_recordings(data_dir: Path) -> None:
    """Some files of every kind and recording."""
    checked = 0
    for folder in sorted({path.parent for path in data_dir.rglob("*") if path.suffix in (".png", ".jpg")}):
        files = sorted(path for path in folder.iterdir() if path.suffix in (".png", ".jpg"))
        for path in files[:: max(len(files) // 3, 1)]:
            data = path.read_bytes()
            color = by_opencv(data, cv2.IMREAD_UNCHANGED).ndim == 3
            image = decode_jpeg(data) if path.suffix == ".jpg" else decode_png(data, color=color)
            expected = by_opencv(data, AS_COLOR if color else cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(image, expected, str(path))
            checked += 1
    assert checked > 20


SMOOTH = cv2.resize(values((6, 8), 8, RGB).astype(np.uint8), (75, 53), interpolation=cv2.INTER_CUBIC)
JPEGS = {
    "plain": (SMOOTH, []),
    "colours in full": (SMOOTH, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]),
    "colours halved sideways": (SMOOTH, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422]),
    "progressive": (SMOOTH, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "with restarts": (SMOOTH, [cv2.IMWRITE_JPEG_RST_INTERVAL, 3]),
    "poor": (SMOOTH, [cv2.IMWRITE_JPEG_QUALITY, 7]),
    "gray": (SMOOTH[..., 1], []),
}


@pytest.mark.parametrize("name", JPEGS)
def test_every_kind_of_jpeg(name: str) -> None:
    image, options = JPEGS[name]
    data = cv2.imencode(".jpg", image, options)[1].tobytes()
    expected = by_opencv(data, AS_COLOR)
    np.testing.assert_array_equal(decode_jpeg(data), expected)
    np.testing.assert_array_equal(decode_color(data, "here"), expected)


def test_a_damaged_jpeg_is_left_to_opencv(capfd: pytest.CaptureFixture[str]) -> None:
    whole = cv2.imencode(".jpg", SMOOTH)[1].tobytes()
    for length in range(len(whole) // 3, len(whole) - 2, 97):
        assert decode_jpeg(whole[:length]) is None
        with pytest.raises(IdRgbdoError, match="truncated JPEG"):
            decode_color(whole[:length], "here")
    middle = len(whole) // 2
    without_middle = whole[: middle - 20] + whole[middle + 20 :]
    assert decode_jpeg(without_middle) is None
    expected = by_opencv(without_middle, AS_COLOR)
    np.testing.assert_array_equal(decode_color(without_middle, "here"), expected)
    with pytest.raises(IdRgbdoError, match="truncated JPEG"):  # the end is not where an end is looked for
        decode_color(whole + bytes(2000), "here")
    capfd.readouterr()  # what OpenCV said to it


def test_without_the_libraries_opencv_decodes(monkeypatch: pytest.MonkeyPatch) -> None:
    color, depth = values((9, 13), 8, RGB).astype(np.uint8), values((9, 13), 16, GRAY).astype(np.uint16)
    files = [cv2.imencode(suffix, image)[1].tobytes() for suffix, image in ((".png", color), (".jpg", color))]
    stored = cv2.imencode(".png", depth)[1].tobytes()
    with_them = [decode_color(data, "here") for data in files]
    monkeypatch.setattr(png_file, "deflate", None)
    monkeypatch.setattr(jpeg, "simplejpeg", None)
    assert decode_png(stored, color=False) is None
    assert decode_jpeg(files[1]) is None
    for data, image in zip(files, with_them, strict=True):
        np.testing.assert_array_equal(decode_color(data, "here"), image)
    np.testing.assert_array_equal(decode_depth(stored, "here"), depth)


def test_gray_levels_are_opencvs() -> None:
    steps = np.r_[0:256:3, 254].astype(np.uint8)
    colors = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, len(steps), 3)
    gray, rgb = gray_and_rgb(colors)
    np.testing.assert_array_equal(rgb, colors[..., ::-1])
    b, g, r = np.moveaxis(colors.astype(np.float64), -1, 0)
    blue, green, red = (np.float64(np.float32(weight)) for weight in (0.114, 0.587, 0.299))
    exact = (r * red + (b * blue + (g * green).astype(np.float32)).astype(np.float32)).astype(np.float32)
    np.testing.assert_array_equal(gray, exact)  # each product is exact in float64: one rounding, as said
    expected = cv2.cvtColor(colors.astype(np.float32), cv2.COLOR_BGR2GRAY)
    np.testing.assert_allclose(gray, expected, rtol=2e-7)  # equal on processors where OpenCV rounds once too
    read_only = colors[::2]
    read_only.flags.writeable = False
    np.testing.assert_array_equal(gray_and_rgb(read_only)[0], gray[::2])


@pytest.mark.parametrize("scale", [1.0, 1000.0, 5000.0, 6553.5, 4999.7])
def test_metres_are_numpys(scale: float) -> None:
    raw = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    expected = raw / np.float32(scale)
    expected[raw == 65535] = 0
    metres = metres_of_16_bits(raw, scale, 65535)
    assert metres.dtype == np.float32
    np.testing.assert_array_equal(metres, expected)


def test_files_are_read_whole_and_what_is_no_file_says_so(tmp_path: Path) -> None:
    stored = values((9, 13), 16, GRAY)
    (tmp_path / "depth.png").write_bytes(png(stored, 16, GRAY, (4,)))
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.png"), stored)
    (tmp_path / "empty.png").touch()
    with pytest.raises(IdRgbdoError, match="empty image file"):
        read_depth(tmp_path / "empty.png")
    for name in ("missing.png", ""):
        with pytest.raises(IdRgbdoError, match="cannot read the image"):
            read_depth(tmp_path / name)
