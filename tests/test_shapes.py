"""How large things may grow: the folder at first sight, a function's parameters, an object's own attributes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

import pytest
from rendered import Film

from idrgbdo_torch import IdRgbdo
from idrgbdo_torch.tracker.backends import BACKENDS, Backend

PACKAGE = Path(__file__).parent.parent / "idrgbdo_torch"
ENTRIES = 24  # of the package's folder
PARAMETERS = {"tracker": 8, "definitions": 8, "commands": 8, "kernels": 9}  # of a function, all kinds, self excluded
ATTRIBUTES = {"IdRgbdo": 10, "Window": 8}


def functions(folder: str) -> Iterator[tuple[str, ast.arguments]]:
    """`file.py:line name` and parameters of every function, method and lambda."""
    for path in sorted((PACKAGE / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
                yield f"{path.relative_to(PACKAGE)}:{node.lineno} {getattr(node, 'name', 'lambda')}", node.args


def parameters(arguments: ast.arguments) -> list[str]:
    """The names of a function's parameters, without self and cls."""
    plain = [a.arg for a in (*arguments.posonlyargs, *arguments.args)]
    rest = [a.arg for a in (arguments.vararg, *arguments.kwonlyargs, arguments.kwarg) if a is not None]
    return [*(plain[1:] if plain[:1] in (["self"], ["cls"]) else plain), *rest]


def test_the_folder_is_seen_at_a_glance() -> None:
    entries = sorted(path.name for path in PACKAGE.iterdir() if path.name != "__pycache__")
    assert len(entries) <= ENTRIES, entries


@pytest.mark.parametrize("folder", PARAMETERS)
def test_no_function_takes_a_long_row_of_parameters(folder: str) -> None:
    found = dict(functions(folder))
    long = {name: parameters(a) for name, a in found.items() if len(parameters(a)) > PARAMETERS[folder]}
    assert len(found) > 10 and not long, f"more than {PARAMETERS[folder]}: {long}"


@pytest.mark.parametrize("folder", [*PARAMETERS, "comparison", "experiments", "runs", "report", "check", "datasets"])
def test_nobody_passes_modules_around(folder: str) -> None:
    given = [
        f"{name}: {a.arg}"
        for name, arguments in functions(folder)
        for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
        if a.annotation is not None and ModuleType.__name__ in ast.unparse(a.annotation)
    ]
    assert not given


@pytest.mark.parametrize("name", [name for name in vars(Backend) if not name.startswith("_")])
def test_a_checker_can_follow_a_call_into_either_backend(name: str) -> None:
    for owner in (Backend, *(type(backend) for backend in BACKENDS.values())):
        hints = get_type_hints(getattr(owner, name))
        assert hints.keys() == get_type_hints(getattr(Backend, name)).keys()
        assert "return" in hints and not {Any, ModuleType, object} & set(hints.values()), owner


def test_an_odometry_and_its_window_keep_few_attributes(desk: Film) -> None:
    odometry = IdRgbdo()
    keyframes = sum(odometry.track(frame).keyframe for frame in desk.frames[:20])
    assert keyframes > 1 and odometry.last_alignment() is not None
    for thing in (odometry, odometry.window):
        own, most = sorted(vars(thing)), ATTRIBUTES[type(thing).__name__]
        assert len(own) <= most, own
