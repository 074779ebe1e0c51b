"""Configuration files: TOML over the defaults of a tree of dataclasses and back, every key and every value checked.

A field's type says what may stand there: `Literal[...]`, or a number with bounds such as `Positive` below.
"""

from __future__ import annotations

import difflib
import json
import types
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import IdRgbdoError
from .files import read_toml
from .plain import shown

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    T = TypeVar("T", bound=DataclassInstance)


@dataclass(frozen=True)
class Bounds:
    """The range of a number: low <= value <= high, or low < value where low itself is excluded."""

    low: float = float("-inf")
    high: float = float("inf")
    low_excluded: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high and not (self.low_excluded and value == self.low)

    def __str__(self) -> str:
        low = f"{'above' if self.low_excluded else 'at least'} {self.low:g}" if self.low != float("-inf") else ""
        high = f"at most {self.high:g}" if self.high != float("inf") else ""
        return " and ".join(filter(None, (low, high)))


LARGEST = 1e100  # of numbers; a setting beyond is a mistake, and its square may be infinite
MOST_COUNTED = 1 << 63  # of whole numbers

Count = Annotated[int, Bounds(1)]
Index = Annotated[int, Bounds(0)]
Positive = Annotated[float, Bounds(0, low_excluded=True)]
NonNegative = Annotated[float, Bounds(0)]
Fraction = Annotated[float, Bounds(0, 1)]


def load(path: Path, defaults: T) -> T:
    """The defaults with what the TOML file says instead; a file holds only differences.

    Raises IdRgbdoError, naming file and key, for a file that cannot be read, an unknown key, a wrong type or range.
    """
    return merge(defaults, read_toml(path), f"{path}: ")


def merge(defaults: T, data: Mapping[str, Any], where: str = "") -> T:
    """The dataclass `defaults` with the nested mapping's values instead. `where` leads every message."""
    hints = get_type_hints(type(defaults), include_extras=True)
    changes: dict[str, Any] = {}
    for key, value in data.items():
        if key not in hints:
            raise IdRgbdoError(f"{where}{shown(key, quoted=False)}: no such key; {_suggestion(key, list(hints))}")
        current = getattr(defaults, key)
        if is_dataclass(current) and not isinstance(current, type):
            if not isinstance(value, Mapping):
                raise IdRgbdoError(
                    f"{where}{key}: expected a table, got {shown(value)}; write [{key}] and its keys below"
                )
            changes[key] = merge(current, value, f"{where}{key}.")
        else:
            changes[key] = _checked(hints[key], value, f"{where}{key}")
    return replace(defaults, **changes)


def check(config: T, where: str = "") -> T:
    """The same tree with whole numbers as floats where those are meant.

    Raises IdRgbdoError for the first field whose value does not fit its type or its bounds.
    """
    if not is_dataclass(config) or isinstance(config, type):
        raise IdRgbdoError(
            f"{where or 'config'}: expected a configuration, got {config!r:.40}; change fields of Config()"
        )
    hints = get_type_hints(type(config), include_extras=True)
    fitting: dict[str, Any] = {}
    for item in fields(config):
        value, hint = getattr(config, item.name), hints[item.name]
        tree = is_dataclass(value) and (type(value) is hint or not is_dataclass(hint))
        fitting[item.name] = (check if tree else partial(_checked, hint))(value, f"{where}{item.name}{'.' * tree}")
    return replace(config, **fitting)


def dump(config: DataclassInstance) -> str:
    """The whole tree as TOML text: values first, then a table for each nested dataclass. None is left out."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(config: DataclassInstance, table: str) -> list[str]:
    values = {item.name: getattr(config, item.name) for item in fields(config)}
    lines = [f"{k} = {_toml(v)}" for k, v in values.items() if not is_dataclass(v) and v is not None]
    for name, value in values.items():
        if is_dataclass(value) and not isinstance(value, type):
            lines += ["", f"[{table}{name}]", *_lines(value, f"{table}{name}.")]
    return lines


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)


def _checked(hint: Any, value: Any, where: str) -> Any:
    """The value, as the type `hint` wants it."""
    fitting = _fit(hint, value)
    if fitting is _MISFIT:
        raise IdRgbdoError(f"{where}: expected {_describe(hint)}, got {shown(value)}; change it")
    return fitting


_MISFIT = object()


def _fit(hint: Any, value: Any) -> Any:
    """The value converted to the type `hint`, or _MISFIT."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        fitting = _fit(args[0], value)
        bounds = (extra for extra in args[1:] if isinstance(extra, Bounds))
        return fitting if fitting is not _MISFIT and all(fitting in bound for bound in bounds) else _MISFIT
    if origin is Literal:
        return value if value in args else _MISFIT
    if origin in (Union, types.UnionType):
        return next((fit for arg in args if (fit := _fit(arg, value)) is not _MISFIT), _MISFIT)
    if origin is tuple:
        items = [_fit(args[0], item) for item in value] if isinstance(value, list | tuple) else [_MISFIT]
        return _MISFIT if _MISFIT in items else tuple(items)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if abs(value) < LARGEST else _MISFIT  # nor NaN
    if hint is int and type(value) is int:
        return value if abs(value) < MOST_COUNTED else _MISFIT
    if hint is Path and isinstance(value, str):
        return Path(value)
    return value if type(value) is hint or (hint is Path and isinstance(value, Path)) else _MISFIT


def _describe(hint: Any) -> str:
    """A type in the words of an error message."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return " ".join([_describe(args[0]), *(str(extra) for extra in args[1:] if isinstance(extra, Bounds))])
    if origin is Literal:
        return "one of " + ", ".join(map(repr, args))
    if origin in (Union, types.UnionType):
        return " or ".join(_describe(arg) for arg in args if arg is not type(None))
    if origin is tuple:
        return f"a list, each {_describe(args[0])}"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text", Path: "a path"}
    return names.get(hint, str(hint))


def _suggestion(key: str, known: list[str]) -> str:
    nearest = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"did you mean '{nearest[0]}'?" if nearest else f"the keys here are {', '.join(known)}"
