"""A video's frames by their number, as its sensor saw them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import IdRgbdoError
from .images import refuse_size


class Video:
    """Reads forwards; to go back is to begin anew, since seeking in a phone's video lands on frames nearby."""

    def __init__(self, path: Path) -> None:
        """Raises IdRgbdoError for a file that is no video."""
        self._path = path
        self._last: NDArray[np.uint8] | None = None  # the image before `_next`
        self._next = 0
        self._ends = 1 << 62  # frames, once the end was met
        self._open()
        self.frames = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))  # as the file says
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS))

    def read(self, index: int) -> NDArray[np.uint8]:
        """(H, W, 3) blue, green, red of frame number `index`. Raises IdRgbdoError where it cannot be decoded."""
        if self._last is not None and index == self._next - 1:
            return self._last
        if index < self._next:
            self._capture.release()
            self._open()
        while self._next < index and self._ends > index:
            self._step(self._capture.grab())
        if self._ends > index:
            there, image = self._capture.read()
            self._step(there)
            if there:
                self._last = np.asarray(image, dtype=np.uint8)
                return self._last
        raise IdRgbdoError(
            f"{self._path}: frame {index} cannot be decoded, the video ends after {self._ends}; copy or download "
            "it again"
        )

    def _step(self, there: bool) -> None:
        """One frame on; or the end, which is remembered, since looking for it again means decoding everything."""
        self._last = None
        if there:
            self._next += 1
        else:
            self._ends = self._next

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        # phones write how to turn the picture for people; depth and poses belong to the sensor's own picture
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if not self._capture.isOpened():
            raise IdRgbdoError(f"{self._path}: expected a video that OpenCV can decode, got none; copy it again")
        size = (self._capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        refuse_size(tuple(map(int, size)), str(self._path))
        self._last, self._next = None, 0
