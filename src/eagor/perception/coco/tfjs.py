"""The network's TensorFlow.js graph model as an ONNX file, written without the packages of either.

A graph model is a JSON file (operations, and a list of weights) and a file with the weights. Its pictures are laid out
``(1, h, w, c)``, those of ONNX ``(1, c, h, w)``. Only the operations of this one network are known here: its files are
those of a known hash, and so is what comes out (`eagor.perception.coco.install`), which computes what the original
does, to float32's rounding.

An ONNX file is Protocol Buffers: a message is a row of fields, each a number (which says what it is, shifted by three
bits, and how it is written) and a value. The numbers are those of the ONNX specification, IR version 8.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Graph", "Output", "onnx_from_tfjs"]

_STORED = {"float32": np.float32, "float16": np.float16, "int32": np.int32}
_BY_ELEMENTS = {"Add": "Add", "Mul": "Mul", "Relu": "Relu", "Sigmoid": "Sigmoid"}


class Output(NamedTuple):
    """An output of the network: its name in the original, its name in the ONNX file, its shape there."""

    original: str
    name: str
    shape: tuple[int, ...]


def onnx_from_tfjs(
    model: bytes, weights: bytes, outputs: Sequence[Output], metadata: Mapping[str, str], name: str
) -> bytes:
    """The ONNX file for a TensorFlow.js graph model, given its two files.

    The one input is called ``images``, float32 ``(1, 3, h, w)``; `metadata` goes into the file.
    """
    described = json.loads(model)
    nodes = {node["name"]: node for node in described["modelTopology"]["node"]}
    conversion = _Conversion(_weights(described["weightsManifest"], weights), Graph(name))
    for node in _in_order(nodes, outputs):
        if node["op"] != "Const":  # written where it is used: the layout depends on that
            conversion.made[node["name"]] = conversion.converted(node["op"], node["name"], node, _inputs(node))
    for output in outputs:
        conversion.graph.operation("Identity", [conversion.made[output.original]], output.name)
        conversion.graph.output(output.name, output.shape)
    return conversion.graph.file(metadata)


def _weights(manifest: Sequence[Mapping[str, Any]], data: bytes) -> dict[str, np.ndarray]:
    """The arrays in `data`, by name: float32 (also those that are stored as float16) and int32."""
    found, at = {}, 0
    for entry in (entry for group in manifest for entry in group["weights"]):
        kind = np.dtype(_STORED[entry.get("quantization", entry)["dtype"]]).newbyteorder("<")
        count = int(np.prod(entry["shape"], dtype=np.int64))
        values = np.frombuffer(data, kind, count, at).reshape(entry["shape"])
        found[entry["name"]] = values.astype(_STORED[entry["dtype"]])
        at += count * kind.itemsize
    return found


def _in_order(nodes: Mapping[str, Any], outputs: Sequence[Output]) -> list[Any]:
    """The operations that `outputs` need, each after those that it needs itself; the same order every time."""
    found: dict[str, Any] = {}
    rest = [output.original for output in reversed(outputs)]
    while rest:
        if lacking := [name for name in _inputs(nodes[rest[-1]]) if name not in found]:
            rest += reversed(lacking)
        else:
            name = rest.pop()
            found.setdefault(name, nodes[name])
    return list(found.values())


def _inputs(node: Mapping[str, Any]) -> list[str]:
    return [name for name in node.get("input", []) if not name.startswith("^")]  # "^" says only: after that one


class _Conversion:
    """The graph in the making; `made`: the name in it of what each operation of the original gives."""

    def __init__(self, weights: Mapping[str, np.ndarray], graph: Graph) -> None:
        self.weights, self.graph = weights, graph
        self.made: dict[str, str] = {}

    def converted(self, kind: str, name: str, node: Mapping[str, Any], inputs: Sequence[str]) -> str:
        """Add one operation; the name of what it gives."""
        if "Conv2" in kind:  # plain, by channel, with or without what is fused with it
            return self.convolution(node, inputs)
        if kind == "Placeholder":
            _, rows, columns, channels = (int(dim["size"]) for dim in node["attr"]["shape"]["shape"]["dim"])
            return self.graph.input("images", (1, channels, rows, columns))
        given = [self.operand(each) for each in inputs if each in self.made or kind in ("Add", "Mul")]
        if kind == "Identity":
            return given[0]
        if kind == "Relu6":
            bounds = [self.graph.constant(f"clip/{bound}", np.asarray(bound, np.float32)) for bound in (0, 6)]
            return self.graph.operation("Clip", [*given, *bounds], name)
        if kind == "Mean":  # over rows and columns, which are kept with size 1
            return self.graph.operation("GlobalAveragePool", given, name)
        if kind == "ConcatV2":  # of the channels
            return self.graph.operation("Concat", given, name, axis=1)
        if kind == "ResizeBilinear":
            size = self.graph.constant(f"{name}/size", self.weights[inputs[1]].astype(np.int64).ravel())
            how = {"mode": "linear", "axes": [2, 3], "coordinate_transformation_mode": "asymmetric"}
            return self.graph.operation("Resize", [*given, "", "", size], name, **how)
        return self.graph.operation(_BY_ELEMENTS[kind], given, name)

    def operand(self, name: str) -> str:
        """An input of an operation by elements. Of constants: one number, or one for each channel."""
        if name in self.made:
            return self.made[name]
        values = self.weights[name]
        shape = () if values.size == 1 else (1, values.size, 1, 1)
        return self.graph.constant(f"{name}/{'x'.join(map(str, shape))}", values.reshape(shape))

    def convolution(self, node: Mapping[str, Any], inputs: Sequence[str]) -> str:
        """A convolution, with the bias and the ReLU that are fused with it."""
        name, attributes = node["name"], node["attr"]
        kernel, group = self.weights[inputs[1]], 1  # (rows, columns, from, to), or (rows, columns, channels, times)
        if "Depthwise" in node["op"]:
            group, kernel = kernel.shape[2], kernel.transpose(2, 3, 0, 1).reshape(-1, 1, *kernel.shape[:2])
        else:
            kernel = kernel.transpose(3, 2, 0, 1)
        given = [self.made[inputs[0]], self.graph.constant(f"{name}/kernel", np.ascontiguousarray(kernel))]
        fused = [base64.b64decode(text) for text in attributes.get("fused_ops", {}).get("list", {}).get("s", [])]
        if b"BiasAdd" in fused:
            given.append(self.graph.constant(f"{name}/bias", self.weights[inputs[2]]))
        padding = {"SAME": "SAME_UPPER", "VALID": "VALID"}[base64.b64decode(attributes["padding"]["s"]).decode()]
        strides, dilations = ([*map(int, attributes[key]["list"]["i"][1:3])] for key in ("strides", "dilations"))
        made = self.graph.operation(
            "Conv", given, f"{name}/convolved" if b"Relu" in fused else name,
            group=group, strides=strides, dilations=dilations, auto_pad=padding,
        )  # fmt: skip
        return self.graph.operation("Relu", [made], name) if b"Relu" in fused else made


# --- ONNX files -------------------------------------------------------------------------------------------------------

IR_VERSION, OPSET = 8, 18  # ONNX 1.13: onnxruntime reads it since 1.14

_ELEMENTS = {np.dtype(np.float32): 1, np.dtype(np.int64): 7}  # TensorProto.DataType
_INT, _STRING, _INTS = 2, 3, 7  # AttributeProto.AttributeType


class Graph:
    """A network in the making: operations in the order in which they run, constants, inputs and outputs by name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._operations: list[bytes] = []
        self._constants: dict[str, bytes] = {}
        self._inputs: list[bytes] = []
        self._outputs: list[bytes] = []

    def constant(self, name: str, values: np.ndarray) -> str:
        """Keep `values` (float32 or int64) under `name`, once, and return the name."""
        dims = b"".join(_field(1, size) for size in values.shape)
        raw = np.asarray(values, values.dtype.newbyteorder("<")).tobytes()
        self._constants[name] = dims + _field(2, _ELEMENTS[values.dtype]) + _field(8, name) + _field(9, raw)
        return name

    def operation(self, kind: str, inputs: Sequence[str], output: str, **attributes: int | str | Sequence[int]) -> str:
        """Add the ONNX operator `kind`, and return the name of its one output. An input left out is an empty name."""
        named = b"".join(_field(1, name) for name in inputs) + _field(2, output) + _field(3, output) + _field(4, kind)
        self._operations.append(named + b"".join(_field(5, _attribute(*each)) for each in sorted(attributes.items())))
        return output

    def input(self, name: str, shape: Sequence[int]) -> str:
        """Add a float32 input, and return its name."""
        self._inputs.append(_tensor(name, shape))
        return name

    def output(self, name: str, shape: Sequence[int]) -> None:
        """What is called `name` is an output, float32."""
        self._outputs.append(_tensor(name, shape))

    def file(self, metadata: Mapping[str, str]) -> bytes:
        """The content of the ONNX file; the same graph always gives the same bytes."""
        parts = ((1, self._operations), (2, [self.name]), (5, self._constants.values()), (11, self._inputs))
        graph = b"".join(_field(which, each) for which, row in (*parts, (12, self._outputs)) for each in row)
        notes = b"".join(_field(14, _field(1, key) + _field(2, text)) for key, text in metadata.items())
        operators = _field(8, _field(1, "") + _field(2, OPSET))
        return _field(1, IR_VERSION) + _field(2, "eagor") + _field(7, graph) + operators + notes


def _varint(number: int) -> bytes:
    """Seven bits to a byte, lowest first."""
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*found, number])


def _field(which: int, value: int | str | bytes) -> bytes:
    """A field: a number, or text or bytes after their length."""
    if isinstance(value, int):
        return _varint(which << 3) + _varint(value)
    content = value.encode() if isinstance(value, str) else value
    return _varint(which << 3 | 2) + _varint(len(content)) + content


def _attribute(name: str, value: int | str | Sequence[int]) -> bytes:
    if isinstance(value, str):
        return _field(1, name) + _field(4, value) + _field(20, _STRING)
    if isinstance(value, int):
        return _field(1, name) + _field(3, value) + _field(20, _INT)
    return _field(1, name) + b"".join(_field(8, each) for each in value) + _field(20, _INTS)


def _tensor(name: str, shape: Sequence[int]) -> bytes:
    dims = b"".join(_field(1, _field(1, size)) for size in shape)
    return _field(1, name) + _field(2, _field(1, _field(1, _ELEMENTS[np.dtype(np.float32)]) + _field(2, dims)))
