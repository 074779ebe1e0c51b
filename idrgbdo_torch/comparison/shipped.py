"""The methods that come along: baselines/, a folder beside the package in a clone, a part of it once installed.

As a top-level package of its own it would stand in the way of others of that name.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from .methods import Method


def shipped_methods() -> dict[str, Method]:
    """By name, the odometries of baselines/ and ours. Nothing of them is imported until it is made."""
    methods: dict[str, Method] = import_module(_name()).METHODS
    return methods


def shipped_folder() -> Path:
    """Where their files lie."""
    return Path(str(import_module(_name()).__file__)).parent


def _name() -> str:
    installed = f"{__package__.partition('.')[0]}.baselines"
    return installed if find_spec(installed) is not None else "baselines"
