"""All frames and keyframes so far: poses hung on keyframes, and the map that these left behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from ..definitions import se3
from ..definitions.growing import Column
from ..definitions.records import UPPER
from ..frame import Keyframe
from ..kernels.se3 import inverse, log_se3, retract
from ..trajectory import Trajectory, timed
from .backends import Backend
from .doubt import LONGEST, SETTLED
from .mapping import LIMIT, NOTHING, Cloud, Kept, condense, keyframe_cloud, world_cloud
from .places import APART, Places
from .smoothing import Departure, Departures, between, smooth_keyframes

Array = NDArray[np.float64]

KEPT_NOTHING = Kept.of(NOTHING)


def pose_column() -> Column:
    """Of poses (4, 4)."""
    return Column("float64", (4, 4))


@dataclass
class History:
    """What was tracked. Frames keep their pose against a keyframe; keyframes move while the window refines them."""

    times: Column = field(default_factory=lambda: Column("float64"))  # s, of every frame
    references: Column = field(default_factory=lambda: Column("int64"))  # its keyframe's number, -1 before the first
    T_cam_kf: Column = field(default_factory=pose_column)  # of every frame against it,
    information: Column = field(default_factory=lambda: Column("float32", (21,)))  # of that, zeros where it is lost
    keyframe_times: Column = field(default_factory=lambda: Column("float64"))
    keyframe_poses: Column = field(default_factory=pose_column)  # T_kf_world, as it stood in the window at last
    tracked: Column = field(default_factory=pose_column)  # T_kf_previous as tracked; NaN where a segment starts
    departures: Departures = field(default_factory=Departures)
    in_window: list[int] = field(default_factory=list)  # numbers of the keyframes that still move, oldest first
    clouds: list[Kept] = field(default_factory=list)  # map points of every keyframe that has left the window
    points: int = 0  # of all clouds
    segment: int = 0  # in which the camera is; a new one begins where a lost track starts anew
    segments: Column = field(default_factory=lambda: Column("int64"))  # of keyframes, until they join an earlier one
    places: Places = field(default_factory=Places)  # where a lost frame may be found again
    doubted: int | None = None  # number of the first keyframe that hangs on a blurred one, see doubt; None without
    doubtful_frames: int = 0  # since then,
    sharp_frames: int = 0  # and those of them that were measured by keyframes that are not blurred themselves

    def add_frame(self, timestamp: float, T_cam_kf: Array, information: Array | None = None) -> None:
        """A frame at a pose against the newest keyframe, with its information (6, 6); None: nothing was measured."""
        self.times.append(timestamp)
        self.references.append(len(self.keyframe_poses) - 1)
        self.T_cam_kf.append(T_cam_kf)
        self.information.append(0.0 if information is None else information[UPPER])

    def add_keyframe(
        self, timestamp: float, T_kf_world: Array, T_kf_previous: Array | None, cloud: Cloud = NOTHING
    ) -> None:
        """A keyframe as tracked against the one before, None where it was not; its cloud where no window refines it."""
        self.keyframe_times.append(timestamp)
        self.tracked.append(np.nan if T_kf_previous is None else T_kf_previous)
        self.keyframe_poses.append(T_kf_world)
        self.clouds.append(Kept.of(cloud) if len(cloud) else KEPT_NOTHING)
        self.points += len(cloud)
        self.segments.append(self.segment)

    def new_segment(self) -> int:
        """The number of a segment that there was not yet."""
        return max(self.segments, default=-1) + 1

    def remember(self, keyframe: Keyframe, backend: Backend) -> None:
        """Keep the newest keyframe as a place to be found again, unless the last place sees the same."""
        number, kept = len(self.keyframe_poses) - 1, self.places.kept
        if kept and self.segments[kept[-1].number] == self.segment:
            place = kept[-1]
            T = self.keyframe_poses[number] @ inverse(self.keyframe_poses[place.number])
            camera, points, coarse = place.keyframe.frame.intrinsics[0], place.keyframe.points, place.keyframe.coarse
            if backend.displacement(camera, points, coarse, np.eye(4), T) < APART * keyframe.frame.camera.width:
                return
        self.places.add(number, keyframe)

    def doubt(self, newest: Keyframe) -> None:
        """Keyframes from the next one on are in doubt; the newest one before is where it may end."""
        self.doubted, self.doubtful_frames, self.sharp_frames = len(self.keyframe_poses), 0, 0
        if max((place.number for place in self.places.kept), default=-1) < self.in_window[-1]:
            self.places.add(self.in_window[-1], newest)

    @property
    def settles(self) -> bool:
        """Whether a doubt has lasted for so long that what is seen now is taken as it is."""
        return self.doubted is not None and (self.sharp_frames >= SETTLED or self.doubtful_frames >= LONGEST)

    @property
    def doubt_reason(self) -> str:
        """Why a pose against the newest keyframe is not to be believed, empty where it is."""
        if self.doubted is None:
            return ""
        return f"measured by keyframes since {self.keyframe_times[self.doubted]:.3f} s, which was blurred"

    def known(self, number: int) -> bool:
        """Whether a keyframe is in no doubt."""
        return self.doubted is None or number < self.doubted

    def settle(self, timestamp: float, T_doubted: Array | None, T_cam_world: Array) -> None:
        """The doubt ends: a frame was said to be at T_doubted (4, 4), and is at T_cam_world.

        The keyframes in doubt are corrected by their share of that in time.
        """
        first, self.doubted = self.doubted, None
        if first is None or T_doubted is None:
            return
        correction, begin = log_se3(inverse(T_doubted) @ T_cam_world), self.keyframe_times[first - 1]
        passed = timestamp - begin
        for number in range(first, len(self.keyframe_poses)):
            share = (self.keyframe_times[number] - begin) / passed if passed > 0.0 else 1.0  # times may stand still
            share = min(max(share, 0.0), 1.0)  # or have gone back in between
            self.keyframe_poses[number] = self.keyframe_poses[number] @ retract(share * correction, np.eye(4))

    def refine(self, poses: Array) -> None:
        """The window's keyframes have new poses (K, 4, 4)."""
        for number, pose in zip(self.in_window, poses, strict=True):
            self.keyframe_poses[number] = pose

    def leave(self, place: int, keyframe: Keyframe, departure: Departure | None = None) -> None:
        """The keyframe at this place of the window is refined no more, but may follow those that stay."""
        number = self.in_window.pop(place)
        self.clouds[number] = Kept.of(keyframe_cloud(keyframe))
        self.points += len(self.clouds[number].xyz)
        if departure is not None:
            self.departures.append(number, self.in_window, departure)

    def leave_all(self, keyframes: Sequence[Keyframe]) -> None:
        """What comes next is tied to none of the keyframes that are still in the window."""
        for keyframe in keyframes:
            self.leave(0, keyframe)

    def forget(self, number: int) -> None:
        """Keyframes from this number on showed what is not the world: nothing of them is mapped or looked for."""
        for n in range(number, len(self.clouds)):
            self.points -= len(self.clouds[n].xyz)
            self.clouds[n] = KEPT_NOTHING
        self.places.kept = [place for place in self.places.kept if place.number < number]

    def condense(self) -> None:
        """Keep the map within its bounds."""
        if self.points > LIMIT:
            moving = {*self.in_window, *(n for n, segment in enumerate(self.segments) if segment != 0)}
            clouds = condense([kept.cloud() for kept in self.clouds], self.keyframe_poses, moving, LIMIT)
            self.clouds = [Kept.of(cloud) if len(cloud) else KEPT_NOTHING for cloud in clouds]
            self.points = sum(map(len, clouds))

    def join(self, segment: int, T_segment_world: Array) -> None:
        """The present segment's world lies at this pose (4, 4) in that of an earlier one: it becomes part of it."""
        mine = {number for number, its in enumerate(self.segments) if its == self.segment}
        for number in mine:
            self.keyframe_poses[number] = self.keyframe_poses[number] @ T_segment_world
            self.segments[number] = segment
        self.departures.move_world(mine, T_segment_world)
        self.segment = segment

    def trajectory(self) -> Trajectory:
        """Every frame's pose by all that is known now: keyframes follow each other, and frames them, smoothly."""
        from .smooth_motion import smoothed  # brings scipy's solvers, which no frame needs

        keyframes = smooth_keyframes(self.keyframe_poses, self.departures)
        times, upper = self.times.array(), self.information.array()
        hung = np.array([self._frame_pose(number, keyframes) for number in range(len(times))]).reshape(-1, 4, 4)
        T_cam_world = smoothed(times, hung, upper, np.isin(times, self.keyframe_times.array()))
        return timed(torch.from_numpy(times), se3.inverse(torch.from_numpy(T_cam_world)))

    def _frame_pose(self, number: int, keyframes: list[Array]) -> Array:
        """T_cam_world of a frame, given those of all keyframes."""
        kf = self.references[number]
        T_cam_kf: Array = self.T_cam_kf[number]
        if kf < 0:
            T_first: Array = T_cam_kf @ (keyframes[0] if keyframes else np.eye(4))
            return T_first
        T_next_kf = self.tracked[kf + 1] if kf + 1 < len(keyframes) else None
        if T_next_kf is None or np.isnan(T_next_kf[0, 0]):
            T_cam_world: Array = T_cam_kf @ keyframes[kf]
            return T_cam_world
        gone, gap = self.times[number] - self.keyframe_times[kf], self.keyframe_times[kf + 1] - self.keyframe_times[kf]
        share = min(max(gone / gap, 0.0), 1.0) if gap > 0.0 else 1.0
        return between(T_cam_kf, keyframes[kf], T_next_kf, keyframes[kf + 1], share)

    def maps(self, window: Sequence[Keyframe]) -> dict[int, Cloud]:
        """By segment, the candidate points of its keyframes in the world, given those that are still in the window."""
        clouds = [kept.cloud() for kept in self.clouds]
        for number, keyframe in zip(self.in_window, window, strict=True):
            clouds[number] = keyframe_cloud(keyframe)
        poses = smooth_keyframes(self.keyframe_poses, self.departures)
        own = {segment: [n for n, its in enumerate(self.segments) if its == segment] for segment in set(self.segments)}
        return {s: world_cloud([clouds[n] for n in ns], [poses[n] for n in ns]) for s, ns in sorted(own.items())}
