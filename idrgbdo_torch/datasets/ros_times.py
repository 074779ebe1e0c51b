"""When the images of a ROS recording were taken: by their headers, or by their recording where those are no clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import IdRgbdoError
from .pairing import MOST_REPEATED

Stamp = tuple[float, int]  # s of the header, ns at which it was recorded


@dataclass(frozen=True)
class Shot:
    """One image of a topic."""

    time: float  # s, by the camera's clock
    stamp: Stamp
    content: int  # a checksum of the image: what is sent twice is one image

    @property
    def recorded(self) -> float:
        """Seconds by the clock of the recorder."""
        return self.stamp[1] / 1e9


@dataclass(frozen=True)
class Shots:
    """The images of a topic, in the order of the recording."""

    topic: str
    images: Sequence[Shot]

    def by_camera(self) -> list[tuple[float, Stamp]]:
        """In the order of the camera's times, of equal ones the first."""
        return _ordered([(image.time, image.stamp) for image in self.images])

    def by_recorder(self) -> list[tuple[float, Stamp]]:
        """In the order in which they were recorded, of equal times the first."""
        return _ordered([(image.recorded, image.stamp) for image in self.images])

    def different(self) -> int:
        """How many images these are, those that were sent twice counted once."""
        return len({(image.time, image.content) for image in self.images})

    def repeats(self) -> int:
        """How many have the camera's time of another image."""
        return self.different() - len({image.time for image in self.images})

    def said(self) -> str:
        """How many repeat a time; nothing where none does."""
        count = self.repeats()
        return f"{self.topic}: {count} of {self.different()} headers repeat the time of another image" if count else ""


def in_time(
    color: Shots, depth: Shots, path: Path
) -> tuple[list[tuple[float, Stamp]], list[tuple[float, Stamp]], tuple[str, ...]]:
    """Colour and depth in the order of their times (s), each time once, and what a user should know.

    Both go by the recorder's clock where the headers of one are no clock, since two clocks may differ; but headers
    that tell apart as many images as have a partner are one, whatever is sent twice. Raises IdRgbdoError where the
    recorder's clock is none either.
    """
    said = [sentence for shots in (color, depth) if (sentence := shots.said())]
    partners = min(color.different(), depth.different())
    if partners <= (1 + MOST_REPEATED) * min(len(color.by_camera()), len(depth.by_camera())):
        first_taken = tuple(f"{sentence}; the first of equal times is taken" for sentence in dict.fromkeys(said))
        return color.by_camera(), depth.by_camera(), first_taken
    of_color, of_depth = color.by_recorder(), depth.by_recorder()
    for shots, ordered in ((color, of_color), (depth, of_depth)):
        if shots.different() - len(ordered) > MOST_REPEATED * shots.different():
            raise IdRgbdoError(
                f"{path}: expected a time for each image, got {len(ordered)} times of recording for "
                f"{shots.different()} images of {shots.topic}, and {'; '.join(said)}; record it again with the "
                "camera's times in the headers"
            )
    instead = "so these are not the times of the images; the times at which they were recorded are taken"
    return of_color, of_depth, (f"{'; '.join(dict.fromkeys(said))}, {instead}",)


def _ordered(images: Sequence[tuple[float, Stamp]]) -> list[tuple[float, Stamp]]:
    first: dict[float, Stamp] = {}
    for time, stamp in images:
        first.setdefault(time, stamp)
    return sorted(first.items())
