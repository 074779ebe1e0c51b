"""The one root of every error that a user can cause; its message is one line that says what to do."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

FOREIGN = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RuntimeError, AssertionError, OSError)


class IdRgbdoError(ValueError):
    """Wrong input: names the argument, what was expected, what came, and what to do about it."""


def door(function: Callable[P, R]) -> Callable[P, R]:
    """A public function whose callers get one sentence for what it cannot work with, whatever library has noticed it.

    What it checks itself it says better; the sentence here lists what came and what the library said.
    """

    @wraps(function)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except IdRgbdoError:
            raise
        except FOREIGN as error:
            said = str(error).strip().split("\n", 1)[0]
            raise IdRgbdoError(
                f"{function.__name__}: expected what its documentation names, got {_given(function, args, kwargs)}: "
                f"{type(error).__name__}, {said or 'nothing said'}; compare shapes and types with help() of it"
            ) from error

    return guarded


def _given(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> str:
    """The arguments of a call in words."""
    try:
        arguments = inspect.signature(function).bind_partial(*args, **kwargs).arguments
    except TypeError:  # more than it takes
        arguments = {**{f"argument {n + 1}": value for n, value in enumerate(args)}, **kwargs}
    return ", ".join(f"{name} {_in_words(value)}" for name, value in arguments.items()) or "nothing"


def _in_words(value: Any) -> str:
    dtype, shape = getattr(value, "dtype", None), None
    if dtype is not None:
        try:
            shape = tuple(value.shape)
        except (RuntimeError, TypeError, AttributeError):  # a tensor without one
            shape = None
    if shape is not None:
        return f"{dtype} {shape}".removeprefix("torch.")
    return str(value) if isinstance(value, bool | float) else type(value).__name__
