"""What a caller gives, as plain dense tensors on the CPU and plain numbers, or one sentence that says why not."""

from __future__ import annotations

import math
import operator
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import IdRgbdoError

SKEW = 1e-3  # by which R^T R may differ from the identity, as after rounding to three digits
ROUNDING = 1e-6  # that of float32, which stays; the nearest rotation takes the place of what is further off


def plain_tensor(name: str, given: object) -> Tensor:
    """A caller's tensor or array of real numbers, with its memory where that can be read as it is.

    A gradient is not followed, masked pixels are 0, another device's are fetched; uint16 becomes int32, of which torch
    can do more. Raises IdRgbdoError for what is no such thing: lists, objects, sparse, quantised or without data.
    """
    if isinstance(given, np.ndarray):
        return torch.from_numpy(_plain_array(name, given))
    if not isinstance(given, Tensor):
        raise IdRgbdoError(
            f"{name}: expected a tensor or a numpy array, got {type(given).__name__}; convert it with numpy.asarray"
        )
    if given.is_nested or given.layout != torch.strided:
        raise IdRgbdoError(f"{name}: expected a dense tensor, got {given.layout}; call its to_dense()")
    if given.is_quantized:
        raise IdRgbdoError(f"{name}: expected plain numbers, got quantised {given.dtype}; call its dequantize()")
    if given.is_complex():
        raise IdRgbdoError(f"{name}: expected real numbers, got {given.dtype}; pass its real part")
    if given.is_meta:
        raise IdRgbdoError(f"{name}: expected a tensor with data, got one on the meta device; pass the image itself")
    try:
        plain = given.detach().cpu().resolve_neg()
        plain = plain.to(torch.int32) if plain.dtype == torch.uint16 else plain
        plain = plain.as_subclass(Tensor)
        plain.numpy()  # those that only look like a tensor have nothing to read
    except (RuntimeError, TypeError, NotImplementedError, IndexError) as error:
        raise IdRgbdoError(
            f"{name}: expected a plain tensor, got {type(given).__name__} {tuple(given.shape)} that cannot be read; "
            "pass it as a numpy array"
        ) from error
    return plain


def _plain_array(name: str, given: NDArray[Any]) -> NDArray[Any]:
    """In the machine's byte order, contiguous and writable, of a type that torch knows."""
    array = np.asarray(np.ma.filled(given, 0) if isinstance(given, np.ma.MaskedArray) else given)
    if array.dtype.kind not in "buif":
        raise IdRgbdoError(f"{name}: expected an array of numbers, got {array.dtype}; convert it with astype")
    wanted = {"u2": np.int32, "u4": np.int64, "u8": np.float64}.get(array.dtype.str[1:])
    if wanted is None and array.dtype.kind == "f" and array.dtype.itemsize > 8:
        wanted = np.float64
    array = np.ascontiguousarray(array, wanted or array.dtype.newbyteorder("="))
    return array if array.flags.writeable else array.copy()  # of a read-only one torch warns


def number(name: str, given: object, unit: str) -> float:
    """A caller's finite number. Raises IdRgbdoError for anything else; unit: what it should be, in words."""
    value = math.nan
    if not isinstance(given, str | bytes | bytearray) and hasattr(given, "__float__"):
        try:
            value = float(given.detach() if isinstance(given, Tensor) else given)
        except (TypeError, ValueError, OverflowError, RuntimeError, NotImplementedError):
            value = math.nan
    if not math.isfinite(value):
        shown = f"{given}" if isinstance(given, float) else type(given).__name__
        raise IdRgbdoError(f"{name}: expected {unit}, a finite number, got {shown}; change it")
    return value


def place(index: object, count: int) -> int:
    """The place among `count` frames of a caller's index, counted from the end where it is negative.

    Raises IndexError after the last, as loops expect, and IdRgbdoError for what is no whole number, slices included.
    """
    try:
        whole = operator.index(index)  # type: ignore[arg-type]
    except TypeError as error:
        raise IdRgbdoError(
            f"frame: expected the number of one frame, got {type(index).__name__}; take several one by one, or open "
            "the recording with start, every and max_frames"
        ) from error
    return range(count)[whole]


def given_path(name: str, given: object) -> Path:
    """A caller's path. Raises IdRgbdoError for what is neither text nor a pathlib.Path."""
    if isinstance(given, str | os.PathLike) and isinstance(os.fspath(given), str):
        return Path(given)
    raise IdRgbdoError(f"{name}: expected text or a pathlib.Path, got {type(given).__name__}; pass one of them")


def rigid(name: str, given: object) -> Tensor:
    """A caller's pose (4, 4) as float64 of its own, the identity for None; IdRgbdoError for what is no rigid motion."""
    if given is None:
        return torch.eye(4, dtype=torch.float64)
    T = plain_tensor(name, given).double().clone()
    if tuple(T.shape) != (4, 4) or not bool(T.isfinite().all()):
        raise IdRgbdoError(f"{name}: expected a finite (4, 4) pose, got {tuple(T.shape)} {T.flatten()[:4].tolist()}...")
    R, last = T[:3, :3], torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    skew = float((R.T @ R - torch.eye(3, dtype=torch.float64)).abs().max())
    if skew > SKEW or float(torch.linalg.det(R)) < 0 or not torch.equal(T[3], last):
        raise IdRgbdoError(
            f"{name}: expected a rotation and a translation over a row 0 0 0 1, got a matrix that is none "
            f"(R^T R differs from the identity by {skew:.2g}); make it rigid"
        )
    if skew > ROUNDING:
        U, _, Vh = torch.linalg.svd(R)
        T[:3, :3] = U @ Vh
    return T
