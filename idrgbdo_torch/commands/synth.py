"""`idrgbdo synth`: a rendered sequence with exact poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagConversionOff, Positional, arg

from ..synthetic.config import SynthConfig
from .output import Output, answer


@dataclass(frozen=True)
class SynthCommand:
    """Render a sequence with exact poses into a folder in TUM's layout."""

    out: Positional[Path]  # a new folder
    scene: Annotated[SynthConfig, arg(name=""), FlagConversionOff] = field(default_factory=SynthConfig)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)


def synth(command: SynthCommand) -> int:
    """Render a sequence into a folder."""
    from ..report.terminal import show_table

    render(command.scene, command.out)
    show_table("rendered", [("frames", str(command.scene.frames)), ("track it", f"idrgbdo run {command.out}")])
    answer(frames=command.scene.frames, folder=command.out)
    return 0


def render(config: SynthConfig, folder: Path) -> None:
    """Render with a progress bar."""
    from ..report.terminal import progress_bar
    from ..synthetic import synth as render_sequence

    with progress_bar("rendering", config.frames) as advance:
        render_sequence(config, folder, lambda done, total: advance(""))
