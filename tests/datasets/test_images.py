"""Image files of every kind that people have: the same depth, or a sentence that names the kind."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.images import as_depth, read_depth
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame

SIZE = (48, 64)
RNG = np.random.default_rng(3)
COLOR = cv2.resize(RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8), SIZE[::-1], interpolation=cv2.INTER_CUBIC)
MM = np.linspace(900, 2300, SIZE[0] * SIZE[1]).reshape(SIZE).astype(np.uint16)
MM[:3] = 0
METRES = MM.astype(np.float32) / 1000

Write = Callable[[Path], object]  # writes the depth of one frame to a path without suffix


def encoded(suffix: str, image: NDArray[np.generic]) -> Write:
    return lambda path: cv2.imwrite(f"{path}{suffix}", image)


def array(image: NDArray[np.generic], **named: NDArray[np.generic]) -> Write:
    if named:
        return lambda path: np.savez_compressed(f"{path}.npz", **named)
    return lambda path: np.save(f"{path}.npy", image)


def exr(**channels: NDArray[np.generic]) -> Write:
    def write(path: Path) -> None:
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(f"{path}.exr")

    return write


def folder_of(parent: Path, depth: Write, color_suffix: str = ".png", extra: str = "") -> Path:
    folder = parent / "mine"
    for kind in ("rgb", "depth"):
        (folder / kind).mkdir(parents=True)
    for k in range(2):
        assert cv2.imwrite(str(folder / "rgb" / f"{k}{color_suffix}"), COLOR)
        depth(folder / "depth" / f"{k}")
    (folder / "camera.toml").write_text("fx=60\nfy=60\ncx=31.5\ncy=23.5\n" + extra)
    return folder


DEPTHS: dict[str, tuple[Write, float]] = {  # how depth is written, and how exact that is, m
    "png": (encoded(".png", MM), 0),
    "capitals": (encoded(".PNG", MM), 0),
    "pgm": (encoded(".pgm", MM), 0),
    "tif": (encoded(".tif", MM), 0),
    "jp2": (encoded(".jp2", MM), 0.001),
    "float tiff": (encoded(".tiff", METRES), 0),
    "pfm": (encoded(".pfm", METRES), 0),
    "three equal channels": (encoded(".png", np.repeat(MM[..., None], 3, axis=2)), 0),
    "three equal channels and alpha": (encoded(".png", np.dstack([MM, MM, MM, np.full_like(MM, 65535)])), 0),
    "uint16": (array(MM), 0),
    "uint16, big end first": (array(MM.astype(">u2")), 0),
    "int16": (array(np.where(MM == 0, -1, MM).astype(np.int16)), 0),
    "int32": (array(MM.astype(np.int32)), 0),
    "uint32": (array(MM.astype(np.uint32)), 0),
    "int64": (array(MM.astype(np.int64)), 0),
    "(H, W, 1)": (array(MM[..., None]), 0),
    "(1, H, W)": (array(METRES[None]), 0),
    "float16": (array(METRES.astype(np.float16)), 1e-3),
    "float32": (array(METRES), 0),
    "float64": (array(METRES.astype(np.float64)), 0),
    "float32, unknown ones": (array(np.where(MM == 0, np.nan, METRES)), 0),
    "npz": (array(METRES, arr_0=METRES), 0),
    "npz of several": (array(METRES, depth=METRES, confidence=MM), 0),
    "exr": (exr(Y=METRES), 0),
    "exr of Blender": (exr(**{"ViewLayer.Depth.Z": METRES, "ViewLayer.Combined.R": METRES * 0}), 0),
    "exr of half floats": (exr(Z=METRES.astype(np.float16)), 1e-3),
    "exr in colour": (exr(RGB=np.dstack([METRES, METRES, METRES])), 0),
}


@pytest.mark.parametrize("kind", DEPTHS)
def test_depth_of_every_kind(kind: str, tmp_path: Path) -> None:
    write, tolerance = DEPTHS[kind]
    if "exr" in kind:
        pytest.importorskip("OpenEXR")
    sequence = open_sequence(folder_of(tmp_path, write))
    frames = list(sequence)
    assert (len(frames), sequence.warnings) == (2, [])
    for frame in frames:
        assert isinstance(frame, RgbdFrame)
        np.testing.assert_allclose(frame.depth.numpy(), METRES, rtol=0, atol=tolerance + 1e-6)


@pytest.mark.parametrize("suffix", [".ppm", ".jpg", ".JPG", ".jpe", ".jp2", ".bmp", ".webp", ".tif", ".avif"])
def test_colour_of_every_kind(suffix: str, tmp_path: Path) -> None:
    frame = open_sequence(folder_of(tmp_path, encoded(".png", MM), suffix)).read(1)
    assert isinstance(frame, RgbdFrame)
    assert frame.color is not None
    assert np.abs(frame.color.numpy()[..., ::-1].astype(int) - COLOR).mean() < 8


def test_integers_have_the_scale_of_the_format_and_their_largest_value_is_unknown(tmp_path: Path) -> None:
    tenths = MM.astype(np.int32) * 50
    frame = open_sequence(folder_of(tmp_path, array(tenths)), depth_scale=50_000).read(0)
    assert isinstance(frame, RgbdFrame)
    np.testing.assert_allclose(frame.depth.numpy(), METRES, atol=1e-6)  # 65535 is a depth here
    holes = MM.copy()
    holes[5, 6] = 32767
    frame = open_sequence(folder_of(tmp_path / "b", array(holes.astype(np.int16)))).read(0)
    assert isinstance(frame, RgbdFrame)
    assert float(frame.depth[5, 6]) == 0


@pytest.mark.parametrize(
    ("write", "complaint"),
    [
        (encoded(".png", (MM // 10).astype(np.uint8)), r"0\.png: expected depth of 16 bits, got an 8-bit depth image"),
        (encoded(".png", np.repeat((MM // 10).astype(np.uint8)[..., None], 3, 2)), "got an 8-bit depth image"),
        (encoded(".jpg", (MM // 10).astype(np.uint8)), "got an 8-bit depth image"),
        (array((MM // 10).astype(np.uint8)), "got an 8-bit depth image"),
        (encoded(".png", COLOR), "expected a 16-bit depth image of one channel, got uint8 with 3"),
        (encoded(".png", MM.byteswap()), "the two bytes of the 16-bit values are swapped"),
        (array(METRES.astype(np.complex64)), "got complex64"),
        (array(METRES, left=METRES, right=METRES), "expected one array called depth, found left, right"),
        (lambda path: Path(f"{path}.npz").write_bytes(b"PK\x03\x04 not whole"), "cannot read the depth"),
        (lambda path: Path(f"{path}.npy").write_bytes(b""), "cannot read the depth"),
        (lambda path: Path(f"{path}.exr").write_bytes(b"no image"), "expected an EXR image, got something else"),
        (lambda path: Path(f"{path}.exr").write_bytes(b"\x76\x2f\x31\x01\x02\0\0\0ab"), "cannot read the image"),
        (exr(left=METRES, right=METRES), "expected depth in a channel Z, Y, depth, D, R, found left, right"),
    ],
)
def test_what_is_no_depth_is_refused_by_its_name(write: Write, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(IdRgbdoError, match=complaint) as caught:
        open_sequence(folder_of(tmp_path, write))
    assert "\n" not in str(caught.value)


def test_smooth_depth_in_the_right_order_is_never_taken_for_swapped_bytes(tmp_path: Path) -> None:
    noisy = np.where(MM > 0, RNG.integers(1, 65535, SIZE), 0).astype(np.uint16)
    near = (MM // 256 * 256).astype(np.uint16)  # coarse steps, smooth either way
    for k, image in enumerate((noisy, near)):
        assert len(open_sequence(folder_of(tmp_path / str(k), encoded(".png", image)))) == 2


def test_without_the_library_exr_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "a.exr").write_bytes(b"")
    with pytest.raises(IdRgbdoError, match=r'pip install "idrgbdo_torch\[exr\]"'):
        read_depth(tmp_path / "a.exr")


def test_depth_stays_what_it_is() -> None:
    assert as_depth(MM, "here").dtype == np.uint16
    assert as_depth(MM[..., None], "here").shape == SIZE
    narrow = np.ones((40, 1), np.uint16)  # one pixel wide, no channel
    assert as_depth(narrow, "here").shape == (40, 1)


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("{:06}_color.png", "{:06}_depth.png"),
        ("frame-{:06}.color.jpg", "frame-{:06}.depth.png"),  # BundleFusion
        ("rgb{}.png", "depth{}.png"),
        ("image_{:04}.bmp", "depth_{:04}.tiff"),
        ("1612345678.{:06}_rgb.png", "1612345678.{:06}_depth.png"),
    ],
)
def test_colour_and_depth_side_by_side_in_one_folder(color: str, depth: str, tmp_path: Path) -> None:
    for k in range(0, 300_000, 100_000):
        number = k if "1612" in color else k // 100_000
        assert cv2.imwrite(str(tmp_path / color.format(number)), COLOR)
        assert cv2.imwrite(str(tmp_path / depth.format(number)), MM)
    (tmp_path / "camera.toml").write_text("fx=60\nfy=60\ncx=31.5\ncy=23.5\n")
    sequence = open_sequence(tmp_path)
    assert sequence.recognised.startswith("folder of images, colour and depth side by side, paired by ")
    assert np.diff(sequence.timestamps) == pytest.approx(0.1 if "1612" in color else 1 / 30, abs=1e-6)
    assert [type(frame) for frame in sequence] == [RgbdFrame] * 3
