"""ONNX files, written without the package `onnx`: the few messages of its format that a network needs.

The format is Protocol Buffers: a message is a row of fields, each a number (which says what it is, shifted by three
bits, and how it is written) and a value. The numbers are those of the ONNX specification, IR version 8.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

__all__ = ["Graph"]

IR_VERSION, OPSET = 8, 18  # ONNX 1.13: onnxruntime reads it since 1.14

_ELEMENTS = {np.dtype(np.float32): 1, np.dtype(np.int64): 7}  # TensorProto.DataType
_INT, _STRING, _INTS = 2, 3, 7  # AttributeProto.AttributeType

Attribute = int | str | Sequence[int]


@dataclass
class Graph:
    """A network in the making: operations in the order in which they run, constants, inputs and outputs by name."""

    name: str
    _operations: list[bytes] = field(default_factory=list)
    _constants: dict[str, bytes] = field(default_factory=dict)
    _inputs: list[bytes] = field(default_factory=list)
    _outputs: list[bytes] = field(default_factory=list)

    def constant(self, name: str, values: np.ndarray) -> str:
        """Keep `values` (float32 or int64) under `name`, once, and return the name."""
        if name not in self._constants:
            kind = _ELEMENTS[values.dtype]
            dims = b"".join(_number(1, size) for size in values.shape)
            raw = np.asarray(values, values.dtype.newbyteorder("<")).tobytes()
            self._constants[name] = dims + _number(2, kind) + _text(8, name) + _bytes(9, raw)
        return name

    def operation(self, kind: str, inputs: Sequence[str], output: str, **attributes: Attribute) -> str:
        """Add the ONNX operator `kind`, and return the name of its one output. An input left out is an empty name."""
        named = b"".join(_text(1, name) for name in inputs) + _text(2, output) + _text(3, output) + _text(4, kind)
        written = b"".join(_bytes(5, _attribute(key, value)) for key, value in sorted(attributes.items()))
        self._operations.append(named + written)
        return output

    def input(self, name: str, shape: Sequence[int]) -> str:
        """Add a float32 input, and return its name."""
        self._inputs.append(_value(name, shape))
        return name

    def output(self, name: str, shape: Sequence[int]) -> None:
        """What is called `name` is an output, float32."""
        self._outputs.append(_value(name, shape))

    def file(self, metadata: Mapping[str, str]) -> bytes:
        """The content of the ONNX file; the same graph always gives the same bytes."""
        graph = b"".join(_bytes(1, operation) for operation in self._operations) + _text(2, self.name)
        graph += b"".join(_bytes(5, constant) for constant in self._constants.values())
        graph += b"".join(_bytes(11, value) for value in self._inputs)
        graph += b"".join(_bytes(12, value) for value in self._outputs)
        notes = b"".join(_bytes(14, _text(1, key) + _text(2, text)) for key, text in metadata.items())
        operators = _bytes(8, _text(1, "") + _number(2, OPSET))
        return _number(1, IR_VERSION) + _text(2, "eagor") + _bytes(7, graph) + operators + notes


def _varint(number: int) -> bytes:
    """Seven bits to a byte, lowest first; negative ones as 64 bits."""
    number &= (1 << 64) - 1
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


def _number(which: int, number: int) -> bytes:
    return _varint(which << 3) + _varint(number)


def _bytes(which: int, content: bytes) -> bytes:
    return _varint(which << 3 | 2) + _varint(len(content)) + content


def _text(which: int, text: str) -> bytes:
    return _bytes(which, text.encode())


def _attribute(name: str, value: Attribute) -> bytes:
    if isinstance(value, str):
        return _text(1, name) + _text(4, value) + _number(20, _STRING)
    if isinstance(value, int):
        return _text(1, name) + _number(3, value) + _number(20, _INT)
    return _text(1, name) + b"".join(_number(8, each) for each in value) + _number(20, _INTS)


def _value(name: str, shape: Sequence[int]) -> bytes:
    dims = b"".join(_bytes(1, _number(1, size)) for size in shape)
    tensor = _number(1, _ELEMENTS[np.dtype(np.float32)]) + _bytes(2, dims)
    return _text(1, name) + _bytes(2, _bytes(1, tensor))
