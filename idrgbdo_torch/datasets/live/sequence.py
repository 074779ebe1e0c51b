"""A running camera as a sequence of frames, whatever library gives them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from ...definitions.camera import Pinhole
from ...errors import IdRgbdoError
from ...frame import BrokenFrame, RgbdFrame
from ...trajectory import Trajectory
from ..builder import FrameBuilder, RawPair
from ..calibration import Calibration
from ..depth_scale import depth_warnings

MISSED = 3  # images in a row that may fail to come before the camera counts as gone

Shot = tuple[float, Callable[[], RawPair]]  # time (s) and the images; raises IdRgbdoError for images of a wrong kind


class Sensor(Protocol):
    """A camera that is running."""

    name: str
    calibration: Calibration
    depth_scale: float  # values per metre
    warnings: tuple[str, ...]  # sentences for the user

    @property
    def dropped(self) -> int | None:
        """Images that the camera numbered and that never came in a pair; None where it numbers none."""

    @property
    def connected(self) -> bool | None:
        """Whether the camera is still there; None where the library does not tell."""

    def capture(self) -> Shot | None:
        """The next image; None where none came in time."""

    def stop(self) -> None:
        """Let go of the camera."""


class EndlessError(IdRgbdoError, TypeError):
    """There is no length. A TypeError, so that list() goes without."""


class LiveSequence:
    """The frames of a running camera, once, in order; as many as asked for unless it stops before."""

    groundtruth: Trajectory | None = None

    def __init__(self, sensor: Sensor, max_frames: int | None, depth_scale: float | None = None) -> None:
        """Wait for the first image, which tells the size. max_frames: None for as long as the camera runs.

        Raises IdRgbdoError where no image comes.
        """
        self._sensor = sensor
        self._max_frames = max_frames
        self.name = sensor.name
        self.timestamps: list[float] = []  # s, of the frames so far
        self.ended = ""  # why the camera gives no more frames, in a sentence; empty while it does
        try:
            self._first = self._capture()
            if self._first is None:
                raise IdRgbdoError(f"sensor: no image came from the {sensor.name} camera; check its cable and port")
            color, depth = self._first[1]()
            scale = depth_scale or sensor.calibration.depth_scale or sensor.depth_scale
            self._builder = FrameBuilder(sensor.calibration, color, scale)
            self._builder.frame(0.0, color, depth)  # colour and depth must fit each other
        except IdRgbdoError:
            sensor.stop()
            raise
        self.camera: Pinhole = self._builder.camera
        self.warnings = [*sensor.warnings, *depth_warnings(depth, scale)]

    @property
    def recognised(self) -> str:
        """What is read, in one line."""
        c = self.camera
        most = "" if self._max_frames is None else f"at most {self._max_frames} frames, "
        return f"{self.name} camera: {c.width}x{c.height}, {most}Ctrl-C ends it before"

    @property
    def dropped(self) -> int | None:
        """Images that the camera took and that were never tracked; None where the camera does not number them."""
        return self._sensor.dropped

    def __len__(self) -> int:
        if self._max_frames is None:
            raise EndlessError("sensor: a camera without max_frames has no length; give max_frames")
        return self._max_frames

    def __iter__(self) -> Iterator[RgbdFrame | BrokenFrame]:
        try:
            shot = self._first
            while shot is not None and self._more():
                timestamp, images = shot
                self.timestamps.append(timestamp)
                yield self._builder.frame_or_reason(timestamp, images)
                shot = self._next() if self._more() else None
        finally:
            self._sensor.stop()

    def __getitem__(self, index: int) -> RgbdFrame | BrokenFrame:
        """Frame number `index`, from the end where it is negative."""
        return self.read(range(len(self))[index])

    def read(self, index: int) -> RgbdFrame | BrokenFrame:
        """Not possible: a camera cannot be asked for a frame by its number. Raises IdRgbdoError."""
        raise IdRgbdoError(
            f"sensor: frame {index} of a live camera cannot be read apart; record it and read the recording"
        )

    def _more(self) -> bool:
        return self._max_frames is None or len(self.timestamps) < self._max_frames

    def _next(self) -> Shot | None:
        """The next image; None where there is none, and `ended` says why: what came before is not lost by an error."""
        try:
            shot = self._capture()
        except IdRgbdoError as error:
            self.ended = str(error)
            return None
        if shot is None:
            self.ended = self._why()
        return shot

    def _capture(self) -> Shot | None:
        """The next image whose time is new; None where the camera is silent or gives the same one again."""
        for _ in range(MISSED):
            shot = self._sensor.capture()
            if shot is not None and (not self.timestamps or shot[0] > self.timestamps[-1]):
                return shot
        return None

    def _why(self) -> str:
        """Why no image comes any more."""
        after = f"after {len(self.timestamps)} frames"
        if self._sensor.connected is False:
            return f"sensor: the {self.name} camera was unplugged {after}; plug it in and start again"
        return (
            f"sensor: no image comes from the {self.name} camera any more {after}: was it unplugged? "
            "Check its cable and port, and start again"
        )
