"""What may go along with a run: a viewer, pictures. What they do lies outside the clock of track()."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ..definitions.se3 import inverse, transform
from ..evaluation import Evaluation
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Odometry, Record, Run, Status
from ..report.pictures import Picture, draw_frames, draw_trajectory, save
from ..trajectory import Trajectory

if TYPE_CHECKING:
    from ..report.viewer import Viewer

Frames = Iterable[RgbdFrame | BrokenFrame]


@dataclass(frozen=True)
class Session:
    """A run while it goes on."""

    folder: Path
    odometry: Odometry
    records: Sequence[Record]  # grows by one with every frame; holds what was done before where a run is continued
    groundtruth: Trajectory | None


class Observer(Protocol):
    """Goes along with a run."""

    def stream(self, frames: Frames, session: Session) -> Frames:
        """The frames, unchanged; what is done with one is done when the next is asked for."""

    def finish(self, done: Run, evaluation: Evaluation | None, session: Session) -> None:
        """After the last frame."""


class Viewing:
    """Shows the run in a viewer."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer

    def stream(self, frames: Frames, session: Session) -> Frames:
        """Every frame is shown once it was tracked."""
        return self._viewer.stream(frames, session.odometry, session.records, session.groundtruth)

    def finish(self, done: Run, evaluation: Evaluation | None, session: Session) -> None:
        """The window stays open."""


class Pictures:
    """Draws the chosen points on some frames, and the path from above, into the run's folder figures/."""

    def stream(self, frames: Frames, session: Session) -> Iterator[RgbdFrame | BrokenFrame]:
        """Some frames leave a picture."""
        return draw_frames(frames, session.odometry, session.records, session.folder / "figures")

    def finish(self, done: Run, evaluation: Evaluation | None, session: Session) -> None:
        """The path."""
        if done.records:
            save(session.folder / "figures" / "trajectory.png", from_above(done, evaluation, session.groundtruth))


def from_above(done: Run, evaluation: Evaluation | None, groundtruth: Trajectory | None) -> Picture:
    """The causal poses, with the reference where it could be laid over them."""
    reference = None
    if evaluation is not None and groundtruth is not None:
        reference = transform(inverse(evaluation.ate.T_reference_estimate), groundtruth.positions)
    keyframes = [number for number, record in enumerate(done.records) if record.result.keyframe]
    lost = [number for number, status in enumerate(done.statuses) if status is Status.LOST]
    return draw_trajectory(done.trajectory().T_world_cam, keyframes, lost, reference)
