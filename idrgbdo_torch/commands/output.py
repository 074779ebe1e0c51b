"""What all commands share of their output: --quiet, --json, and the object that the latter ends with."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg


@dataclass(frozen=True)
class Output:
    """How much is said."""

    quiet: Annotated[bool, arg(aliases=("-q",))] = False  # show nothing but warnings and errors
    json: bool = False  # the same, and end with one JSON object on stdout: what was measured, and where it lies


_facts: ContextVar[dict[str, Any] | None] = ContextVar("facts", default=None)


def answer(**facts: Any) -> None:
    """Add to the object that --json ends with: numbers, texts, paths, and lists and mappings of these."""
    known = _facts.get()
    if known is not None:
        known.update(facts)


@contextlib.contextmanager
def collected() -> Iterator[dict[str, Any]]:
    """All that is answered meanwhile."""
    facts: dict[str, Any] = {}
    token = _facts.set(facts)
    try:
        yield facts
    finally:
        _facts.reset(token)


@contextlib.contextmanager
def silence(wanted: bool) -> Iterator[None]:
    """Where wanted, nothing reaches stdout, and no notice stderr; warnings and errors do."""
    if not wanted:
        yield
        return
    log = logging.getLogger("idrgbdo_torch")
    level = log.level
    log.setLevel(logging.ERROR)  # the notice that kernels are compiled
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        log.setLevel(level)


def as_json(facts: Mapping[str, Any]) -> str:
    """One object on one line; what is no number becomes null."""
    return json.dumps(_plain(facts), allow_nan=False, ensure_ascii=True)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value.absolute())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
