"""Footage without an end, from a few frames: forwards, backwards, and so on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count

from idrgbdo_torch.frame import RgbdFrame


def back_and_forth(frames: Sequence[RgbdFrame]) -> Iterator[RgbdFrame]:
    """At 30 frames a second; the motion is that of a camera that turns back, without jumps."""
    turn = [*frames, *frames[-2:0:-1]]
    return (replace(turn[number % len(turn)], timestamp=number / 30) for number in count())
