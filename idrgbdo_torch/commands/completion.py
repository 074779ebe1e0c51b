"""`idrgbdo completion`: words of the command that a shell completes when Tab is pressed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class CompletionCommand:
    """Print a script that lets a shell complete commands, flags and their values."""

    shell: Positional[Literal["bash", "zsh", "fish"]]  # bash: eval "$(idrgbdo completion bash)" in ~/.bashrc


def completion(command: CompletionCommand) -> int:
    """Write the script to stdout."""
    from .cli import parse

    try:
        parse(["--tyro-print-completion", command.shell])
    except SystemExit as end:
        return int(end.code or 0)
    return 0
