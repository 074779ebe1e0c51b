"""What `idrgbdo doctor` asks for and does."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .doctor import Item


@dataclass(frozen=True)
class DoctorCommand:
    """Show versions, machine, optional parts and caches, and test in seconds whether tracking works here."""

    self_test: bool = True  # render a tiny sequence and track it


def doctor(command: DoctorCommand) -> int:
    """Show each group as soon as it is known; the exit status is 1 where something is not in order."""
    from . import doctor as diagnosis

    groups = [diagnosis.versions, diagnosis.extras, diagnosis.machine, diagnosis.caches]
    items: list[Item] = []
    for group in groups:
        found = group()
        _show(found)
        items += found
    if command.self_test:
        items.append(diagnosis.self_test())
        _show(items[-1:])
    bad = [item for item in items if not item.good]
    print(f"not in order: {', '.join(item.name for item in bad)}" if bad else "all in order")
    return 1 if bad else 0


def _show(items: list[Item]) -> None:
    for item in items:
        sys.stdout.write(f"  {'ok ' if item.good else 'BAD'}  {item.name:<23} {item.value}\n")
        if not item.good:
            sys.stdout.write(f"       {'':<23} {item.advice}\n")
    sys.stdout.flush()
