"""What a run tracked, left in its folder: the recording and how it was read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import IdRgbdoError

NAME = "input.json"


def remember(folder: Path, sequence: Path, options: Mapping[str, Any]) -> None:
    """Write the recording and its reading options; paths become absolute."""
    values = {"sequence": sequence, **options}
    written = {name: str(value.resolve()) if isinstance(value, Path) else value for name, value in values.items()}
    (folder / NAME).write_text(json.dumps(written, indent=2) + "\n", encoding="utf-8")


def recall(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The recording that the run in a folder tracked, and its reading options, paths as text."""
    if not (folder / NAME).exists():
        raise IdRgbdoError(f"source: the run '{folder}' does not say what it tracked; name the recording instead")
    try:
        options = dict(json.loads((folder / NAME).read_text(encoding="utf-8")))
        sequence = Path(options.pop("sequence"))
    except (ValueError, KeyError, TypeError) as error:
        raise IdRgbdoError(f"source: '{folder / NAME}' is damaged ({error}); name the recording instead") from error
    if not sequence.exists():
        raise IdRgbdoError(f"source: '{folder}' tracked '{sequence}', which is gone; name the recording instead")
    return sequence, options
