"""Headers of ROS recordings that repeat a time: images don't vanish in silence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bag_writer
import numpy as np
import pytest
import torch
from bag_writer import START, Encode, Messages, write_bag
from rendered import Film

from idrgbdo_torch import Pinhole
from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.trajectory import Trajectory

SECOND = 10**9  # ns
Clock = Callable[[int], int]  # what a header says instead of a time, both in ns


def _film(images: int) -> Film:
    """So many different images of 16x12, thirty a second."""
    camera = Pinhole(width=16, height=12, fx=15, fy=15, cx=7.5, cy=5.5)

    def frame(k: int) -> RgbdFrame:
        color = torch.full((12, 16, 3), k, dtype=torch.uint8)
        return RgbdFrame(k / 30, color[..., 0].float(), torch.full((12, 16), 1 + k / 100), camera, color)

    poses = torch.eye(4, dtype=torch.float64).repeat(images, 1, 1)
    return Film(tuple(map(frame, range(images))), Trajectory(torch.arange(images, dtype=torch.float64), poses))


def _by(clock: Clock) -> tuple[Encode, Encode]:
    """Writers of colour and of depth whose headers go by this clock."""

    def color(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        return bag_writer.rgb8(messages, clock(stamp), image)

    def depth(messages: Messages, stamp: int, image: np.ndarray) -> tuple[str, object]:
        return bag_writer.metres(messages, clock(stamp), image)

    return color, depth


def _to_seconds(stamp: int) -> int:
    return stamp // SECOND * SECOND


def _standing(stamp: int) -> int:
    return 17 * SECOND


def _to_tenths(stamp: int) -> int:
    return stamp // (SECOND // 10) * (SECOND // 10)


@pytest.mark.parametrize("clock", [_to_seconds, _standing, _to_tenths])
def test_headers_that_are_no_clock_are_replaced_by_the_times_of_recording(clock: Clock, tmp_path: Path) -> None:
    color, depth = _by(clock)
    film = _film(40)
    sequence = open_sequence(write_bag(film, tmp_path / "a.bag", color=color, depth=depth))
    assert sequence.timestamps == pytest.approx([START + f.timestamp + 0.03 for f in film.frames], abs=1e-6)
    (warning,) = sequence.warnings
    assert "of 40 headers repeat the time of another image" in warning
    assert "the times at which they were recorded are taken" in warning
    for frame, expected in zip(sequence, film.frames, strict=True):
        assert isinstance(frame, RgbdFrame)
        torch.testing.assert_close(frame.depth, expected.depth)


def test_both_go_by_the_recorder_where_one_has_no_clock(tmp_path: Path) -> None:
    film = _film(40)
    sequence = open_sequence(write_bag(film, tmp_path / "a.bag", depth=_by(_to_seconds)[1]))
    assert len(sequence) == 40
    assert sequence.timestamps[0] == pytest.approx(START + 0.03, abs=1e-6)
    assert len(sequence.warnings) == 1


def test_a_few_equal_times_are_counted(tmp_path: Path) -> None:
    fourth, fifth = (START * SECOND + round(k / 30 * 1e6) * 1000 for k in (4, 5))

    def stuck_once(stamp: int) -> int:
        return fourth if stamp == fifth else stamp

    film = _film(40)
    sequence = open_sequence(write_bag(film, tmp_path / "a.bag", color=_by(stuck_once)[0]))
    assert len(sequence) == 39
    (warning,) = sequence.warnings
    assert warning.endswith("1 of 40 headers repeat the time of another image; the first of equal times is taken")


def test_an_image_that_is_sent_twice_is_no_repeat(tmp_path: Path) -> None:
    film = _film(20)
    twice = Film(tuple(frame for frame in film.frames for _ in range(2)), film.groundtruth)
    sequence = open_sequence(write_bag(twice, tmp_path / "a.bag"))
    assert len(sequence) == 20
    assert sequence.warnings == []


def test_without_any_clock_it_says_what_to_do(tmp_path: Path) -> None:
    color, depth = _by(_standing)
    path = write_bag(_film(20), tmp_path / "a.bag", color=color, depth=depth, burst=True)
    with pytest.raises(
        IdRgbdoError, match=r"got 1 times of recording for 20 images of .* record it again with the cam"
    ):
        open_sequence(path)


def test_headers_stay_where_images_are_sent_again_with_other_bytes(tmp_path: Path) -> None:
    film = _film(40)

    def again(frame: RgbdFrame) -> RgbdFrame:
        return replace(frame, color=frame.color + 1, gray=frame.gray + 1)

    twice = Film(tuple(one for f in film.frames for one in (f, again(f))), film.groundtruth)
    sequence = open_sequence(write_bag(twice, tmp_path / "a.bag"))
    assert sequence.timestamps == pytest.approx([START + f.timestamp for f in film.frames], abs=1e-6)
    (warning,) = sequence.warnings
    assert warning.endswith("40 of 80 headers repeat the time of another image; the first of equal times is taken")
