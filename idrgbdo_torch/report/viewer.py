"""A run as it happens, in Rerun: camera, points, keyframes, window, trajectory, entropy; live or into an .rrd file.

Needs the extra `viewer`. Nothing here runs within the clock of track().
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..config import NoiseConfig
from ..definitions.camera import backproject, project
from ..definitions.se3 import inverse, transform
from ..errors import IdRgbdoError
from ..frame import BrokenFrame, RgbdFrame
from ..odometry import Record, Status
from ..tracker.inspection import Inspectable
from ..tracker.mapping import keyframe_cloud
from ..trajectory import Trajectory, nearest
from .pictures import information_colors

FREEDOMS = ("x", "y", "z", "rotation x", "rotation y", "rotation z")
CHUNK = 30  # poses of one piece of the path: a piece is sent again as it grows, the whole path never
OUTLIER = NoiseConfig().outlier  # standard deviations: a residual drawn in full red
JPEG = 80  # quality of the images
BLUE, GRAY, GOLD, RED = (31, 98, 201), (150, 150, 150), (230, 160, 20), (205, 48, 48)
STATUS_LEVEL = {Status.OK: "INFO", Status.WEAK: "WARN", Status.LOST: "ERROR"}


class Viewer:
    """A stream of frames into a Rerun window, a file, or both. Close it, or use it in a `with`."""

    def __init__(self, title: str, *, window: bool = False, save: Path | None = None) -> None:
        """window: open Rerun's viewer. save: write an .rrd file. IdRgbdoError where that is impossible."""
        self._rr = _load_rerun()
        self._stream = self._rr.RecordingStream("idrgbdo", recording_id=None)
        sinks: list[Any] = []
        if save is not None:
            _check_writable(save)
            sinks.append(self._rr.FileSink(str(save)))
        if window:
            _check_display()
            self._stream.spawn(connect=False, hide_welcome_screen=True)
            sinks.append(self._rr.GrpcSink())
        self._stream.set_sinks(*sinks, default_blueprint=_blueprint())
        self._stream.send_recording_name(title)
        self._number = 0
        self._begin: float | None = None
        self._path: list[NDArray[np.float64]] = []  # positions, m
        self._log("world", self._rr.ViewCoordinates.RDF, static=True)
        for name in FREEDOMS:
            self._log(f"entropy/{name}", self._rr.SeriesLines(names=name), static=True)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Send what is left. The window stays open."""
        self._stream.flush()
        self._stream.disconnect()

    def stream(
        self, frames: Iterable[RgbdFrame | BrokenFrame], odometry: object, records: Sequence[Record],
        reference: Trajectory | None = None,
    ) -> Iterator[RgbdFrame | BrokenFrame]:  # fmt: skip
        """The frames, unchanged; each is shown after it was tracked, when the next one is asked for.

        records: grows by one with every frame that was tracked.
        """
        for frame in frames:
            before = len(records)
            yield frame
            if len(records) > before and isinstance(odometry, Inspectable):
                record = records[-1]
                if self._number == 0 and reference is not None and len(reference):
                    self.show_reference(reference, frame.timestamp, record.result.T_world_cam.numpy())
                self.show(frame, record, odometry)

    def show_reference(self, reference: Trajectory, start: float, T_world_cam: NDArray[np.float64]) -> None:
        """The true path, moved so that its pose at the time `start` (s) is T_world_cam."""
        first = reference.T_world_cam[nearest(reference.timestamps, torch.tensor([start], dtype=torch.float64))[0]]
        positions = transform(torch.from_numpy(T_world_cam) @ inverse(first), reference.positions)
        self._log("world/reference", self._rr.LineStrips3D([positions.numpy()], colors=GRAY), static=True)

    def show(self, frame: RgbdFrame | BrokenFrame, record: Record, odometry: Inspectable) -> None:
        """One frame that has just been tracked."""
        begin = frame.timestamp if self._begin is None else self._begin
        self._begin = begin
        self._stream.set_time("frame", sequence=self._number)
        self._stream.set_time("time", duration=frame.timestamp - begin)
        self._show_camera(frame, record)
        self._show_points(odometry, record)
        if record.result.keyframe:
            self._show_keyframes(odometry)
        self._show_numbers(record)
        self._number += 1

    def _show_camera(self, frame: RgbdFrame | BrokenFrame, record: Record) -> None:
        rr, T = self._rr, record.result.T_world_cam.numpy()
        self._path.append(T[:3, 3])
        piece = self._number // CHUNK
        points = self._path[max(piece * CHUNK - 1, 0) :]
        self._log(f"world/trajectory/{piece}", rr.LineStrips3D([points], colors=BLUE))
        self._log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        if isinstance(frame, BrokenFrame):
            return
        camera = frame.camera
        frustum = rr.Pinhole(
            focal_length=(camera.fx, camera.fy), principal_point=(camera.cx, camera.cy), width=camera.width,
            height=camera.height, image_plane_distance=0.15,
        )  # fmt: skip
        self._log("world/camera/image", frustum)
        pixels = frame.gray.round().clamp(0, 255).to(torch.uint8) if frame.color is None else frame.color
        self._log("world/camera/image", rr.Image(pixels.numpy()).compress(jpeg_quality=JPEG))

    def _show_points(self, odometry: Inspectable, record: Record) -> None:
        """The points tracked, coloured by information; around each a ring coloured by its residual; in space too."""
        rr = self._rr
        uv, bits = odometry.last_points()
        colors = information_colors(bits.numpy() / max(float(bits.max()), 1e-9)) if len(bits) else []
        self._log("world/camera/image/points", rr.Points2D(uv.numpy(), colors=colors, radii=4.0))
        aligned = odometry.last_alignment()
        if aligned is None:
            self._log("world/camera/image/residuals", rr.Clear(recursive=False))
            self._log("world/camera/points", rr.Clear(recursive=False))
            return
        keyframe, tracked = aligned
        seen = tracked.rms >= 0.0
        index = tracked.index[seen]
        camera = keyframe.frame.camera
        host_uv = torch.from_numpy(keyframe.points.uv[index])
        P = backproject(camera, host_uv, torch.from_numpy(keyframe.points.inv_depth[index]))
        P = transform(torch.from_numpy(tracked.T_frame_kf), P)
        at, _ = project(camera, P)
        rms = tracked.rms[seen]
        heat = np.clip(rms / OUTLIER, 0.0, 1.0)[:, None]
        colors = ((1 - heat) * np.array([40, 200, 90]) + heat * np.array(RED)).astype(np.uint8)
        labels = [f"{value:.1f} sigma" for value in rms]
        residuals = rr.Points2D(at.numpy(), colors=colors, radii=2.0, labels=labels, show_labels=False)
        self._log("world/camera/image/residuals", residuals)
        self._log("world/camera/points", rr.Points3D(P.numpy(), colors=colors, radii=0.008))
        self._log("numbers/median residual", rr.Scalars(float(np.median(rms)) if len(rms) else 0.0))

    def _show_keyframes(self, odometry: Inspectable) -> None:
        """The newest keyframe with its points; the window's poses as refined."""
        rr = self._rr
        held = odometry.window_keyframes()
        if not held:
            return
        centres = []
        for number, (_, T_kf_world) in held.items():
            T_world_kf = np.linalg.inv(T_kf_world)
            centres.append(T_world_kf[:3, 3])
            pose = rr.Transform3D(translation=T_world_kf[:3, 3], mat3x3=T_world_kf[:3, :3])
            self._log(f"world/keyframes/{number}", pose)
        self._log("world/window", rr.LineStrips3D([centres], colors=GOLD, radii=0.003))
        newest = max(held)
        keyframe = held[newest][0]
        camera = keyframe.frame.camera
        frustum = rr.Pinhole(
            focal_length=(camera.fx, camera.fy), width=camera.width, height=camera.height, image_plane_distance=0.05,
            color=GOLD,
        )  # fmt: skip
        self._log(f"world/keyframes/{newest}/frustum", frustum, static=True)
        cloud = keyframe_cloud(keyframe)
        points = rr.Points3D(cloud.xyz, colors=cloud.rgb, radii=0.004)
        self._log(f"world/keyframes/{newest}/points", points)

    def _show_numbers(self, record: Record) -> None:
        rr, result = self._rr, record.result
        for name, bits in zip(FREEDOMS, result.entropy_bits, strict=False):
            self._log(f"entropy/{name}", rr.Scalars(bits))
        if record.track_ms is not None:
            self._log("numbers/track ms", rr.Scalars(record.track_ms))
        self._log("numbers/points", rr.Scalars(result.points))
        notes = [text for text in (result.reason, "keyframe" if result.keyframe else "") if text]
        if notes:
            self._log("log", rr.TextLog("; ".join(notes), level=STATUS_LEVEL[result.status]))

    def _log(self, path: str, what: Any, *, static: bool = False) -> None:
        self._stream.log(path.replace(" ", "_"), what, static=static)


@contextmanager
def open_viewer(title: str, window: bool, save: Path | None) -> Iterator[Viewer | None]:
    """A viewer if a window or a file is wanted, else None."""
    if not window and save is None:
        yield None
        return
    with Viewer(title, window=window, save=save) as viewer:
        yield viewer


def _load_rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise IdRgbdoError(
            f'viewer: needs Rerun, which cannot be imported ({error}); pip install "idrgbdo_torch[viewer]"'
        ) from error
    return rerun


def _blueprint() -> Any:
    """What is seen at first: space on the left; image, entropy, numbers and log on the right."""
    import rerun.blueprint as views

    right = views.Vertical(
        views.Spatial2DView(origin="world/camera/image", name="points by information"),
        views.TimeSeriesView(origin="entropy", name="entropy of each degree of freedom, bits"),
        views.TimeSeriesView(origin="numbers", name="points, residual, ms"),
        views.TextLogView(origin="log", name="log"),
        row_shares=[3, 2, 2, 1],
    )
    left = views.Spatial3DView(origin="world", name="world")
    return views.Blueprint(views.Horizontal(left, right, column_shares=[3, 2]), collapse_panels=True)


def _check_writable(path: Path) -> None:
    if path.suffix.lower() != ".rrd":
        raise IdRgbdoError(f"save_rrd: expected a name ending in .rrd, got '{path}'; choose another file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    except OSError as error:
        raise IdRgbdoError(f"save_rrd: cannot write '{path}': {error.strerror}; choose another file") from error


def _check_display() -> None:
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise IdRgbdoError(
            "viewer: expected a display to open a window on, got none; use --save-rrd FILE and open that elsewhere"
        )
