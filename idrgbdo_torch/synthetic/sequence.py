"""A rendered sequence as frames, and as a folder in TUM's layout."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..errors import IdRgbdoError
from .config import SynthConfig
from .faults import camera_file, jump_gain, spoilt_depth, stated_intrinsics, understood_depth
from .paths import Array, CameraPath, handheld_path, quaternion, recorded_path

if TYPE_CHECKING:
    from ..definitions.camera import Pinhole
    from ..frame import RgbdFrame
    from ..trajectory import Trajectory
    from .render import Renderer

Progress = Callable[[int, int], None]  # frames done, frames in all


@dataclass(frozen=True)
class Shot:
    """One frame as the sensor's files hold it."""

    color: npt.NDArray[np.uint8]  # (H, W, 3) RGB
    depth: npt.NDArray[np.uint16]  # (H, W), DEPTH_SCALE per metre, 0 where invalid


@dataclass(frozen=True)
class RenderedSequence:
    """Frames of a rendered scene along a known path, made when asked for: the same bits in any order."""

    config: SynthConfig

    def __len__(self) -> int:
        return self.config.frames

    def __iter__(self) -> Iterator[RgbdFrame]:
        for index in range(len(self)):
            yield self.read(index)

    @property
    def name(self) -> str:
        return f"{self.config.kind}_{self.config.trajectory.stem if self.config.trajectory else 'handheld'}"

    @property
    def warnings(self) -> list[str]:
        """Nothing to warn of."""
        return []

    def __getitem__(self, index: int) -> RgbdFrame:
        """Frame number `index`, from the end where it is negative."""
        from ..definitions.given import place

        return self.read(place(index, len(self)))

    def read(self, index: int) -> RgbdFrame:
        """Frame `index`, rendered now; the same as reading it back from write_tum's folder."""
        import cv2
        import torch

        from ..frame import RgbdFrame

        shot = self.shot(index)
        gray = cv2.cvtColor(shot.color.astype(np.float32), cv2.COLOR_RGB2GRAY)  # ITU-R BT.601
        depth = understood_depth(shot.depth, self.config.faults)
        return RgbdFrame(
            timestamp=self.timestamps[index],
            gray=torch.from_numpy(gray),
            depth=torch.from_numpy(depth),
            camera=self.camera,
            color=torch.from_numpy(shot.color),
        ).owned()

    @cached_property
    def camera(self) -> Pinhole:
        """As the calibration has it."""
        from ..definitions.camera import Pinhole

        c = self.config
        fx, fy, cx, cy = stated_intrinsics(c)
        readout, delay = (c.faults.readout_ms, c.faults.depth_delay_ms) if c.faults.named else (0.0, 0.0)
        return Pinhole(
            width=c.width, height=c.height, fx=fx, fy=fy, cx=cx, cy=cy, readout_ms=readout, depth_delay_ms=delay
        )

    @cached_property
    def path(self) -> CameraPath:
        """The camera's path, in the trajectory file's own time and world."""
        c = self.config
        duration = (c.frames - 1) / c.rate
        if c.trajectory is None:
            return handheld_path(c.start + duration, c.seed)
        return recorded_path(c.trajectory, c.start, duration)

    @cached_property
    def timestamps(self) -> list[float]:
        """Centres of the exposures in s, whole microseconds."""
        c = self.config
        first = self.path.first + (c.start if c.trajectory is None else 0.0)
        return [round(first + index / c.rate, 6) for index in range(c.frames)]

    @cached_property
    def T_world_cam(self) -> Array:
        """(N, 4, 4) exact poses."""
        return np.stack([self.path.pose(t) for t in self.timestamps])

    @cached_property
    def groundtruth(self) -> Trajectory:
        import torch

        from ..trajectory import Trajectory

        return Trajectory(
            timestamps=torch.tensor(self.timestamps, dtype=torch.float64),
            T_world_cam=torch.from_numpy(self.T_world_cam.copy()),
        )

    @cached_property
    def T_scene_world(self) -> Array:
        """(4, 4): the scene is built with z up around the middle of the path."""
        from .layout import scene_from_world

        return scene_from_world(self.T_world_cam)

    @cached_property
    def renderer(self) -> Renderer:
        from .render import Renderer
        from .scenes import build_scene
        from .world import build_world

        c = self.config
        scene = build_scene(c.kind, self.T_scene_world @ self.T_world_cam, c.seed)
        return Renderer(build_world(scene, c.seed, c.fx / 525.0, c.threads), c)

    @cached_property
    def exposure(self) -> float:
        """Gain that puts the sequence's mean radiance at a comfortable level, as a camera's automatic exposure does."""
        picks = np.linspace(0, len(self) - 1, min(len(self), 5)).astype(int)
        means = [self.renderer.radiance(self._pose, self.timestamps[i], 0.0).mean() for i in picks]
        return 0.22 / max(float(np.mean(means)), 1e-6)

    def _pose(self, t: float | Array) -> Array:
        return np.asarray(self.T_scene_world @ self.path.pose(t))

    def shot(self, index: int) -> Shot:
        """Frame `index` as uint8 colour and uint16 depth."""
        from .depth_sensors import measured_depth
        from .sensor import develop, exposure_gain

        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        c, s, f = self.config, self.config.sensor, self.config.faults
        t = self.timestamps[index]
        radiance = self.renderer.radiance(self._pose, t, s.exposure_s if s.motion_blur else 0.0, f.readout_ms / 1e3)
        since = t - self.timestamps[0]
        gain = self.exposure * exposure_gain(since, s, c.seed) * jump_gain(since, f.exposure_jump, c.seed)
        seen = self.renderer.depth(self._pose(t + f.depth_delay_ms / 1e3))
        light, range_noise = (np.random.default_rng([c.seed, index, stream]) for stream in (2, 3))
        return Shot(
            color=develop(radiance, gain, s, light),
            depth=spoilt_depth(measured_depth(seen, s, f, range_noise), f),
        )


def write_tum(sequence: RenderedSequence, folder: Path, progress: Progress | None = None) -> None:
    """Write rgb/, depth/, rgb.txt, depth.txt, associations.txt, groundtruth.txt and the camera.

    The camera is calibration.txt, or camera.toml where it names faults.

    Raises IdRgbdoError where the folder cannot be written.
    """
    import cv2

    folder = Path(folder)
    try:
        for name in ("rgb", "depth"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise IdRgbdoError(f"out: expected a folder that can be made, got {error}; name another") from error
    stamps = [f"{t:.6f}" for t in sequence.timestamps]
    for index, stamp in enumerate(stamps):
        shot = sequence.shot(index)
        images = (("rgb", np.ascontiguousarray(shot.color[..., ::-1])), ("depth", shot.depth))
        for name, image in images:
            file = folder / name / f"{stamp}.png"
            if not cv2.imwrite(str(file), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
                raise IdRgbdoError(f"out: expected a folder with room, could not write {file}; free some space")
        if progress is not None:
            progress(index + 1, len(stamps))
    c = sequence.config
    title = f"# rendered: {c.kind}, seed {c.seed}, {c.trajectory.name if c.trajectory else 'built-in path'}\n"
    (folder / "depth.txt").write_text(title + "# timestamp filename\n" + _lines(f"{s} depth/{s}.png" for s in stamps))
    both = (f"{s} rgb/{s}.png {s} depth/{s}.png" for s in stamps)
    (folder / "associations.txt").write_text(_lines(both))
    poses = (_pose_line(s, T) for s, T in zip(stamps, sequence.T_world_cam, strict=True))
    (folder / "groundtruth.txt").write_text(title + "# timestamp tx ty tz qx qy qz qw\n" + _lines(poses))
    write_camera(c, folder)
    # last: a folder with rgb.txt is complete
    (folder / "rgb.txt").write_text(title + "# timestamp filename\n" + _lines(f"{s} rgb/{s}.png" for s in stamps))


def write_camera(config: SynthConfig, folder: Path) -> None:
    """Write calibration.txt, or camera.toml where there is more to tell than four numbers."""
    fx, fy, cx, cy = stated_intrinsics(config)
    if config.faults.named:
        (folder / "camera.toml").write_text(camera_file(config))
    else:
        (folder / "calibration.txt").write_text(f"{fx!r} {fy!r} {cx!r} {cy!r}\n")


def synth(config: SynthConfig, out: Path, progress: Progress | None = None) -> RenderedSequence:
    """Render a sequence into a new or empty folder in TUM's layout; returns it.

    Raises IdRgbdoError where the folder cannot be written, or has anything in it but hidden files.
    """
    folder = Path(out)
    there = [path.name for path in sorted(folder.iterdir()) if path.name[0] != "."] if folder.is_dir() else []
    if there:
        raise IdRgbdoError(f"out: expected a new folder, got '{folder}' with a '{there[0]}'; empty it or name another")
    sequence = RenderedSequence(config)
    write_tum(sequence, out, progress)
    return sequence


def _lines(rows: Iterator[str]) -> str:
    return "\n".join(rows) + "\n"


def _pose_line(stamp: str, T: Array) -> str:
    values = [*T[:3, 3], *quaternion(T[:3, :3])]
    return stamp + "".join(f" {v:.12f}" for v in values)
