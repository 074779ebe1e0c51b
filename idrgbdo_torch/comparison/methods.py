"""What a comparison needs to know of a method. Imports nothing heavy, so that a list of methods costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from ..odometry import Odometry

Kind = Literal["ours", "baseline", "null"]


@dataclass(frozen=True)
class Method:
    """One row of a comparison: how to make the odometry, and what to say of it."""

    description: str  # one line
    make: Callable[[int], Odometry]  # from a seed; a function of a module, so that another process can make it too
    kind: Kind = "baseline"  # the speed of others is measured against the fastest baseline
    random: bool = False  # whether the seed matters
    settings: Callable[[], str] = str  # text of everything that was configured; part of the key of a result
    libraries: tuple[str, ...] = ("torch",)  # distributions whose version is part of that key too


Methods = Mapping[str, Method]
