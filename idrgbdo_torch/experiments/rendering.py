"""The rendered set: made once into a cache, folder by folder, side by side."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import IdRgbdoError
from ..synthetic import FaultConfig, SynthConfig
from ..synthetic.sequence import RenderedSequence, write_tum
from .relatives import RELATIVES, Relative, recorded_for, write_builtin_path
from .sweep import Progress, Result, Workers, run_tasks

if TYPE_CHECKING:
    from ..synthetic.render import Renderer

SYNTHETIC = Path(__file__).resolve().parent.parent / "synthetic"


@dataclass(frozen=True)
class RenderTask:
    """A rendered relative, and the folder it goes to."""

    relative: Relative
    config: SynthConfig  # with the recorded trajectory, or none for the built-in path
    folder: Path


@dataclass(frozen=True)
class Take:
    """Which films of the same relatives: tuned on some, a method is judged on others."""

    later: float = 0.0  # s by which they begin later along a recorded path
    look: int = 0  # of textures and scene


FIRST = Take()
LOOKS = 100  # seeds from one look to the next


@dataclass(frozen=True)
class FurtherSequence(RenderedSequence):
    """A rendered sequence whose scene keeps `further` metres more away than it would by itself."""

    further: float = 0.0

    @cached_property
    def renderer(self) -> Renderer:
        """The scene is built around a wider path than the camera's."""
        from ..synthetic.render import Renderer
        from ..synthetic.scenes import build_scene
        from ..synthetic.world import build_world

        c = self.config
        T = self.T_scene_world @ self.T_world_cam
        around = [self.further * np.array(step) for step in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))]
        wide = np.concatenate([T, *(_moved(T, step) for step in around)]) if self.further else T
        scene = build_scene(c.kind, wide, c.seed)
        return Renderer(build_world(scene, c.seed, c.fx / 525.0, c.threads), c)


def _moved(T: Any, step: Any) -> Any:
    moved = T.copy()
    moved[:, :3, 3] += step
    return moved


def plan_rendering(
    names: Sequence[str],
    frames: int,
    cache: Path,
    trajectories: Path | None = None,
    shrink: int = 1,
    take: Take = FIRST,
) -> list[RenderTask]:
    """What to render for the named sequences; `shrink` divides the image size, for tests.

    Raises IdRgbdoError where a folder of trajectories is named that has none of theirs.
    """
    chosen = [(number, relative) for number, relative in enumerate(RELATIVES) if relative.name in names]
    recorded = {relative.name: recorded_for(relative, trajectories) for _, relative in chosen}
    if trajectories is not None and not any(recorded.values()):
        raise IdRgbdoError(
            f"trajectories: expected files such as freiburg1_desk.txt in '{trajectories}', found none; "
            "leave it out to film along built-in paths"
        )
    tasks = []
    for number, relative in chosen:
        path = recorded[relative.name]
        config = SynthConfig(
            kind=relative.kind,
            trajectory=path,
            start=relative.start + take.later if path else 0.0,
            frames=frames,
            seed=number + LOOKS * take.look,
            width=640 // shrink,
            height=480 // shrink,
            fx=525.0 / shrink,
            fy=525.0 / shrink,
            cx=(319.5 + 0.5) / shrink - 0.5,
            cy=(239.5 + 0.5) / shrink - 0.5,
        )
        tasks.append(RenderTask(relative, config, cache / f"{relative.name}_{_digest(relative, config)}"))
    return tasks


def with_faults(film: RenderTask, faults: FaultConfig) -> RenderTask:
    """The same film by a camera with faults, beside it."""
    config = replace(film.config, faults=faults)
    return replace(
        film, config=config, folder=film.folder.parent / f"{film.relative.name}_{_digest(film.relative, config)}"
    )


def render(task: RenderTask) -> Result:
    """Render into the task's folder, which is complete or not there."""
    if is_rendered(task):
        return {"folder": str(task.folder)}
    config = task.config
    unfinished = None
    try:
        task.folder.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(prefix=f"{task.folder.name}.", dir=task.folder.parent))
        unfinished.chmod(0o755)
        if config.trajectory is None:
            path = unfinished / "path.txt"
            write_builtin_path(path, task.relative, (config.frames + 2) / config.rate, config.seed)
            config = replace(config, trajectory=path)
        write_tum(FurtherSequence(config, task.relative.further), unfinished)
        unfinished.rename(task.folder)
    except OSError as error:
        if not is_rendered(task):  # else another process was faster
            raise IdRgbdoError(f"cache: cannot write '{task.folder}': {error}; pass another --cache") from error
    finally:
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
    return {"folder": str(task.folder)}


def render_missing(
    tasks: Sequence[RenderTask], workers: Workers, on_progress: Callable[[Progress], None] = lambda progress: None
) -> None:
    """Render what is not in the cache yet. Raises IdRgbdoError where one of them fails."""
    errors: list[str] = []

    def on_result(name: str, result: Result) -> None:
        if "error" in result:
            errors.append(f"{name}: {result['error']}")

    missing = {task.folder.name: task for task in tasks if not is_rendered(task)}
    run_tasks(render, missing, workers, on_result, on_progress)
    if errors:
        raise IdRgbdoError(f"rendering failed for {'; '.join(errors)}")


def is_rendered(task: RenderTask) -> bool:
    """Whether the folder is there; rgb.txt is written last."""
    return (task.folder / "rgb.txt").exists()


def _digest(relative: Relative, config: SynthConfig) -> str:
    """Of everything that decides the images."""
    path = config.trajectory
    parts = {**asdict(relative), **asdict(replace(config, trajectory=None))}
    film = path.read_bytes() if path else b"built-in"
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode() + film + _code_digest()).hexdigest()[:10]


@lru_cache(maxsize=1)
def _code_digest() -> bytes:
    digest = hashlib.sha256((Path(__file__).parent / "relatives.py").read_bytes())
    for path in sorted(SYNTHETIC.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()
