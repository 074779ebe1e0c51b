"""Trees of known types as text and numbers, and back. Reading one runs no code: it can only make what is in the table.

A tree is made of None, bool, int, float, str, list, tuple, dict, numpy arrays and scalars, torch tensors, numpy
generators, and instances of the types of a table: enums, NamedTuples, dataclasses (their fields, handed to the
constructor) and plain classes (their attributes). It is written as a list of nodes, children first, and one block of
numbers. What the tree holds twice is written once and is one object again after reading; loops cannot be written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from math import prod
from typing import Any

import numpy as np
import torch

from ..definitions.growing import Column
from ..errors import IdRgbdoError

SIMPLE = (type(None), bool, int, float, str)
DTYPES = {
    np.dtype(name).name: np.dtype(name)
    for name in ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64")
}
BROKEN = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, MemoryError, RuntimeError)
DATACLASS = "__dataclass_fields__"
Node = list[Any]
Keep = Callable[[np.ndarray[Any, Any]], Any]  # what JSON can hold, of more than one part
Kept = Callable[[Any], bytes]


class Codec:
    """Writes and reads trees of the types of one table."""

    def __init__(self, types: Iterable[type], constants: Mapping[str, object] | None = None) -> None:
        """types: what may occur, told apart by name. constants: objects that are kept by name, such as a backend."""
        self._types = {kind.__name__: kind for kind in types}
        self._constants = dict(constants or {})

    def write(self, tree: object, keep: Keep | None = None) -> tuple[dict[str, Any], list[bytes | memoryview]]:
        """What JSON can hold, and the numbers. Raises IdRgbdoError for a type that is not in the table.

        keep: takes what never changes, the full chunks of columns, and gives what is written in their place.
        """
        writer = _Writer(self._types, self._constants, keep)
        return {"root": writer.reference(tree), "nodes": writer.nodes}, writer.numbers

    def read(self, text: Mapping[str, Any], numbers: memoryview, kept: Kept | None = None) -> Any:
        """The tree. Raises IdRgbdoError where the text is not of this kind or asks for a type not in the table.

        kept: gives the bytes of what was kept apart.
        """
        reader = _Reader(self._types, self._constants, numbers, kept)
        try:
            for node in text["nodes"]:
                reader.made.append(reader.make(node))
            return reader.value(text["root"])
        except BROKEN as error:
            raise IdRgbdoError(f"tree: cannot be read ({type(error).__name__}: {error}); write it again") from error


class _Writer:
    def __init__(self, types: Mapping[str, type], constants: Mapping[str, object], keep: Keep | None) -> None:
        self._types = types
        self._keep = keep
        self._constants = {id(value): name for name, value in constants.items()}
        self._known: dict[int, int] = {}  # number of the node by the identity of what it holds
        self._alive: list[object] = []  # so that no identity is given twice
        self.nodes: list[Node] = []
        self.numbers: list[bytes | memoryview] = []

    def reference(self, value: object) -> Any:
        """A simple value as it is, else [number of its node]."""
        if type(value) in SIMPLE:
            return value
        number = self._known.get(id(value))
        if number is None:
            node = self._node(value)
            number = len(self.nodes)
            self.nodes.append(node)
            self._known[id(value)] = number
            self._alive.append(value)
        return [number]

    def _node(self, value: Any) -> Node:
        kind = type(value)
        if id(value) in self._constants:
            return ["constant", self._constants[id(value)]]
        if kind in (list, tuple):
            return [kind.__name__, [self.reference(item) for item in value]]
        if kind is dict:
            return ["dict", [[self.reference(key), self.reference(item)] for key, item in value.items()]]
        if kind is Column:
            full = [self._chunk(chunk) for chunk in value.full]
            return ["column", value.dtype, list(value.shape), full, self.reference(value.last[: value.count].copy())]
        if kind is np.ndarray:
            return self._array("array", value)
        if isinstance(value, np.generic):
            return self._array("scalar", np.asarray(value))
        if kind is torch.Tensor:
            return self._array("tensor", value.detach().cpu().contiguous().numpy())
        if kind is np.random.Generator:
            return ["generator", self.reference(value.bit_generator.state)]
        if self._types.get(kind.__name__) is not kind:
            name = f"{kind.__module__}.{kind.__qualname__}"
            raise IdRgbdoError(f"checkpoint: '{name}' is not among the types that it may hold; name it in the table")
        return ["object", kind.__name__, self._parts(value)]

    def _array(self, kind: str, array: np.ndarray[Any, Any]) -> Node:
        if DTYPES.get(array.dtype.name) != array.dtype:
            raise IdRgbdoError(f"checkpoint: an array of {array.dtype} cannot be written; convert it")
        columns = array.ndim > 1 and array.flags.f_contiguous and not array.flags.c_contiguous
        flat = np.ascontiguousarray(array.T if columns else array)  # the order in memory decides the last bit of sums
        self.numbers.append(flat.reshape(-1).view(np.uint8).data)
        return [kind, array.dtype.name, list(array.shape), columns]

    def _chunk(self, chunk: np.ndarray[Any, Any]) -> Any:
        return self.reference(chunk) if self._keep is None else self._keep(chunk)

    def _parts(self, value: Any) -> Any:
        if isinstance(value, Enum):
            return value.name
        if isinstance(value, tuple):
            return [self.reference(item) for item in value]
        held = {f.name: getattr(value, f.name) for f in fields(value) if f.init} if is_dataclass(value) else vars(value)
        return {name: self.reference(item) for name, item in held.items()}


class _Reader:
    def __init__(
        self,
        types: Mapping[str, type],
        constants: Mapping[str, object],
        numbers: memoryview,
        kept: Kept | None,
    ) -> None:
        self._types = types
        self._kept = kept
        self._constants = constants
        self._numbers = numbers
        self._position = 0
        self.made: list[Any] = []
        self._makers: dict[str, Callable[..., Any]] = {
            "constant": lambda name: self._constants[name],
            "list": lambda items: [self.value(item) for item in items],
            "tuple": lambda items: tuple(self.value(item) for item in items),
            "dict": lambda items: {self.value(key): self.value(item) for key, item in items},
            "array": self._array,
            "column": self._column,
            "scalar": lambda *node: self._array(*node)[()],
            "tensor": lambda *node: torch.from_numpy(self._array(*node)).clone(),  # in memory that torch has aligned
            "generator": self._generator,
            "object": self._object,
        }

    def make(self, node: Node) -> Any:
        return self._makers[node[0]](*node[1:])

    def value(self, reference: Any) -> Any:
        if type(reference) in SIMPLE:
            return reference
        (number,) = reference
        if type(number) is not int or number < 0:  # nodes made so far are counted from 0
            raise ValueError(f"no node {number!r}")
        return self.made[number]

    def _array(self, dtype: str, shape: list[int], columns: bool) -> np.ndarray[Any, Any]:
        if any(type(size) is not int or size < 0 for size in shape):
            raise ValueError(f"an array of shape {shape}")
        end = self._position + prod(shape) * DTYPES[dtype].itemsize
        if end > len(self._numbers):
            raise ValueError(f"an array of shape {shape}, where the file ends")
        flat = np.frombuffer(self._numbers[self._position : end], dtype=DTYPES[dtype])
        self._position = end
        return flat.reshape(shape[::-1]).copy().T if columns else flat.reshape(shape).copy()

    def _column(self, dtype: str, shape: list[int], full: list[Any], last: Any) -> Column:
        column = Column(DTYPES[dtype].name, tuple(shape))
        whole = (column.rows, *column.shape)
        for chunk in full:
            array = self.made[chunk[0]] if len(chunk) == 1 else self._apart(chunk, dtype, whole)
            if array.shape != whole or array.dtype != DTYPES[dtype]:
                raise ValueError(f"a chunk of shape {array.shape}")
            array.flags.writeable = False
            column.full.append(array)
        rest = self.value(last)
        if rest.dtype != DTYPES[dtype]:
            raise ValueError(f"entries of {rest.dtype}")
        column.extend(rest)
        return column

    def _apart(self, chunk: Any, dtype: str, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
        if self._kept is None:
            raise ValueError("a chunk that was kept apart")
        return np.frombuffer(self._kept(chunk), dtype=DTYPES[dtype]).reshape(shape).copy()

    def _generator(self, state: Any) -> np.random.Generator:
        generator = np.random.default_rng()
        generator.bit_generator.state = self.value(state)
        return generator

    def _object(self, name: str, parts: Any) -> Any:
        kind: Any = self._types[name]
        if issubclass(kind, Enum):
            return kind[parts]
        if issubclass(kind, tuple):
            return kind(*[self.value(part) for part in parts])
        held = {key: self.value(part) for key, part in parts.items()}
        if hasattr(kind, DATACLASS):
            return kind(**held)
        made = kind.__new__(kind)
        vars(made).update(held)
        return made
