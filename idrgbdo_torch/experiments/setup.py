"""From folders and flags to a Lab."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from ..config import Config, settings_file
from ..errors import IdRgbdoError
from ..text import configfile
from .lab import find_clips, short_name
from .relatives import RELATIVES
from .rendering import FIRST, RenderTask, Take, plan_rendering, render_missing
from .sweep import Progress, Workers
from .task import Clip

FRAMES, QUICK_FRAMES = 240, 60  # of a rendered sequence
SEEDS, QUICK_SEEDS = 10, 3
QUICK_NAMES = (  # one of each kind
    *("fr1_desk", "fr2_desk", "fr2_xyz", "fr3_cabinet", "fr3_nostructure_texture_far"),
    *("fr3_structure_notexture_near", "fr3_structure_texture_far", "fr3_structure_texture_near"),
)
TABLE_ORDER = [relative.name for relative in RELATIVES]


def default_cache() -> Path:
    """The user's cache for rendered sequences."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "idrgbdo" / "rendered"


def rendered_clips(
    names: str,
    frames: int,
    quick: bool,
    cache: Path,
    trajectories: Path | None,
    workers: Workers,
    on_progress: Callable[[Progress], None],
    shrink: int = 1,
) -> tuple[Clip, ...]:
    """The rendered set, or the named ones of it (commas between); what is not in the cache is rendered now."""
    return clips_of(planned_films(names, frames, quick, cache, trajectories, shrink), workers, on_progress)


def planned_films(
    names: str, frames: int, quick: bool, cache: Path, trajectories: Path | None, shrink: int = 1, take: Take = FIRST
) -> tuple[RenderTask, ...]:
    """What to render for the rendered set, or for the named ones of it (commas between)."""
    wanted = [name.strip() for name in names.split(",") if name.strip()] or list(QUICK_NAMES if quick else TABLE_ORDER)
    for name in wanted:
        if name not in TABLE_ORDER:
            raise IdRgbdoError(f"sequences: no rendered sequence '{name}'; expected some of {', '.join(TABLE_ORDER)}")
    return tuple(plan_rendering(wanted, frames, cache, trajectories, shrink, take))


def clips_of(
    films: Sequence[RenderTask], workers: Workers, on_progress: Callable[[Progress], None]
) -> tuple[Clip, ...]:
    """The rendered films; what is not in the cache is rendered now."""
    render_missing(films, workers, on_progress)
    return find_clips([film.folder for film in films], None)


def recorded_clips(folder: Path, names: str, frames: int | None) -> tuple[Clip, ...]:
    """The recordings in a folder, those of Table 1 first; or the named ones (commas between)."""
    if not folder.is_dir():
        raise IdRgbdoError(f"data: expected a folder of recordings at '{folder}', found none; see idrgbdo download tum")
    found = {short_name(path): path for path in sorted(folder.iterdir()) if (path / "rgb.txt").exists()}
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in found:
            raise IdRgbdoError(
                f"sequences: no recording '{name}' in '{folder}'; there are {', '.join(found) or 'none'}"
            )
    if not found:
        raise IdRgbdoError(f"data: no recording with rgb.txt in '{folder}'; get some: idrgbdo download tum --all")
    order = {name: number for number, name in enumerate(TABLE_ORDER)}
    chosen = sorted(wanted or found, key=lambda name: (order.get(name, len(order)), name))
    return find_clips([found[name] for name in chosen], frames)


def paper_config(path: Path | None) -> Config:
    """The paper's configuration: from the file, else the one that comes along."""
    return configfile.load(settings_file(path or Path("paper")), Config())
