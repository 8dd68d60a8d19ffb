"""TensorFlow.js graph models as ONNX: the operations that convolutional detectors use.

A graph model is a JSON file (operations, and a list of weights) and a file with the weights. Its pictures are laid out
``(1, h, w, c)``, those of ONNX ``(1, c, h, w)``. What is not understood is refused, never guessed: the result computes
what the original does, to float32's rounding.

The ONNX file is written without the package `onnx`, which is large: a network needs few messages of its format. That is
Protocol Buffers: a message is a row of fields, each a number (which says what it is, shifted by three bits, and how it
is written) and a value. The numbers are those of the ONNX specification, IR version 8.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eagor.errors import FormatError

__all__ = ["Graph", "Output", "onnx_from_tfjs", "read_weights"]

_STORED = {"float32": np.float32, "float16": np.float16, "int32": np.int32}


@dataclass(frozen=True)
class Output:
    """An output of the network: its name in the original, its name in the ONNX file, its shape there."""

    original: str
    name: str
    shape: tuple[int, ...]


def onnx_from_tfjs(
    model: bytes, weights: bytes, outputs: tuple[Output, ...], metadata: Mapping[str, str], name: str
) -> bytes:
    """The ONNX file for a TensorFlow.js graph model, given its two files.

    The one input is called ``images``, float32 ``(1, 3, h, w)``; `metadata` goes into the file. Raises `FormatError`
    for a file that is corrupt, and for an operation that is not known here: it names it.
    """
    try:
        described = json.loads(model)
        nodes = {node["name"]: node for node in described["modelTopology"]["node"]}
        values = read_weights(described["weightsManifest"], weights)
        conversion = _Conversion(values, Graph(name))
        for node in _in_order(nodes, [output.original for output in outputs]):
            conversion.add(node)
        for output in outputs:
            conversion.graph.operation("Identity", [conversion.made[output.original]], output.name)
            conversion.graph.output(output.name, output.shape)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(
            f"this is no TensorFlow.js graph model that can be read ({type(error).__name__}: {error}); wanted the JSON "
            "with modelTopology and weightsManifest, and its weights"
        ) from error
    return conversion.graph.file(metadata)


def read_weights(manifest: list[dict[str, Any]], data: bytes) -> dict[str, np.ndarray]:
    """The arrays in `data`, by name: float32 (also those that are stored as float16) and int32.

    Raises `FormatError` where they do not fill `data` exactly, or are stored in another way.
    """
    found: dict[str, np.ndarray] = {}
    at = 0
    for entry in (entry for group in manifest for entry in group["weights"]):
        stored = entry.get("quantization", entry)["dtype"]
        if entry["dtype"] not in ("float32", "int32") or stored not in _STORED:
            raise FormatError(f"{entry['name']} is {entry['dtype']} stored as {stored}; known are {', '.join(_STORED)}")
        kind, count = np.dtype(_STORED[stored]).newbyteorder("<"), int(np.prod(entry["shape"], dtype=np.int64))
        if count < 0 or at + count * kind.itemsize > len(data):
            raise FormatError(f"the weights end within {entry['name']}: {len(data)} bytes")
        values = np.frombuffer(data, kind, count, at).reshape(entry["shape"])
        found[entry["name"]] = values.astype(_STORED[entry["dtype"]])
        at += count * kind.itemsize
    if at != len(data):
        raise FormatError(f"{len(data)} bytes of weights; the model speaks of {at}")
    return found


def _in_order(nodes: Mapping[str, Any], wanted: list[str]) -> list[Any]:
    """The operations that `wanted` need, each after those that it needs itself; the same order every time."""
    found: list[Any] = []
    done: dict[str, bool] = {}  # False while what it needs is looked for
    rest = list(reversed(wanted))
    while rest:
        name = rest[-1]
        if name not in nodes:
            raise FormatError(f"the model speaks of {name!r}, which is not in it")
        if name in done:
            rest.pop()
            if not done[name]:
                done[name] = True
                found.append(nodes[name])
            continue
        done[name] = False
        for needed in reversed(_inputs(nodes[name])):
            if done.get(needed) is False:
                raise FormatError(f"the operations {needed!r} and {name!r} need each other")
            if needed not in done:
                rest.append(needed)
    return found


def _inputs(node: Mapping[str, Any]) -> list[str]:
    return [name for name in node.get("input", []) if not name.startswith("^")]  # "^" says only: after that one


@dataclass
class _Conversion:
    weights: Mapping[str, np.ndarray]
    graph: Graph
    made: dict[str, str] = field(default_factory=dict)  # the name in the ONNX graph, by the original's

    def add(self, node: Mapping[str, Any]) -> None:
        kind = node["op"]
        if kind == "Const":
            return  # written where it is used: the layout depends on that
        if kind not in _OPERATIONS:
            raise FormatError(f"{node['name']} is {kind}, which is not known here: {', '.join(sorted(_OPERATIONS))}")
        self.made[node["name"]] = _OPERATIONS[kind](self, node, _inputs(node))

    def refuse(self, node: Mapping[str, Any], why: str) -> FormatError:
        return FormatError(f"{node['name']} ({node['op']}) {why}")

    def placeholder(self, node: Mapping[str, Any], _: list[str]) -> str:
        batch, rows, columns, channels = (int(dim["size"]) for dim in node["attr"]["shape"]["shape"]["dim"])
        if (batch, channels) != (1, 3) or min(rows, columns) < 1:
            raise self.refuse(node, f"takes {(batch, rows, columns, channels)}; wanted (1, rows, columns, 3)")
        return self.graph.input("images", (1, 3, rows, columns))

    def same(self, _: Mapping[str, Any], inputs: list[str]) -> str:
        return self.made[inputs[0]]

    def convolution(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        name, by_channel = node["name"], "Depthwise" in node["op"]
        if _text(node, "data_format") != "NHWC":
            raise self.refuse(node, f"is laid out {_text(node, 'data_format')}; wanted NHWC")
        kernel = self.weights[inputs[1]]  # (rows, columns, from, to), or (rows, columns, channels, times)
        group = 1
        if by_channel:
            group, kernel = kernel.shape[2], kernel.transpose(2, 3, 0, 1).reshape(-1, 1, *kernel.shape[:2])
        else:
            kernel = kernel.transpose(3, 2, 0, 1)
        given = [self.made[inputs[0]], self.graph.constant(f"{name}/kernel", np.ascontiguousarray(kernel))]
        fused = [base64.b64decode(text).decode() for text in _list(node, "fused_ops", "s")]
        if fused[:1] == ["BiasAdd"]:
            given.append(self.graph.constant(f"{name}/bias", self.weights[inputs[2]]))
        after = fused[1:] if fused[:1] == ["BiasAdd"] else fused
        if after not in ([], ["Relu"], ["Relu6"]):
            raise self.refuse(node, f"is followed by {after}; known are Relu and Relu6")
        made = self.graph.operation(
            "Conv", given, f"{name}/convolved" if after else name, group=group, **self.window(node, kernel.shape[2:])
        )
        return self.clipped(name, made, after[0]) if after else made

    def window(self, node: Mapping[str, Any], size: tuple[int, ...]) -> dict[str, Any]:
        """Strides, dilations and padding of a convolution with a kernel of this `size` (rows, columns)."""
        strides, dilations = (_list(node, key, "i")[1:3] for key in ("strides", "dilations"))
        found = {"strides": strides, "dilations": dilations}
        if (padding := _text(node, "padding")) not in ("SAME", "VALID"):
            raise self.refuse(node, f"pads by {padding}; wanted SAME or VALID")
        if padding == "VALID":
            return found | {"auto_pad": "VALID"}
        if dilations == [1, 1]:
            return found | {"auto_pad": "SAME_UPPER"}
        if strides != [1, 1]:
            raise self.refuse(node, f"has strides {strides} and dilations {dilations}; wanted ones in one of them")
        total = [(reach - 1) * step for reach, step in zip(size, dilations, strict=True)]
        return found | {"pads": [*(each // 2 for each in total), *(each - each // 2 for each in total)]}

    def clipped(self, name: str, given: str, kind: str) -> str:
        if kind == "Relu":
            return self.graph.operation("Relu", [given], name)
        bounds = [self.graph.constant(f"clip/{bound}", np.asarray(bound, np.float32)) for bound in (0, 6)]
        return self.graph.operation("Clip", [given, *bounds], name)

    def activation(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        return self.clipped(node["name"], self.made[inputs[0]], node["op"])

    def sigmoid(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        return self.graph.operation("Sigmoid", [self.made[inputs[0]]], node["name"])

    def pairwise(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        return self.graph.operation(
            node["op"].removesuffix("V2"), [self.operand(node, name) for name in inputs], node["name"]
        )

    def operand(self, node: Mapping[str, Any], name: str) -> str:
        """An input of an operation by elements. Of constants: one number, or one for each channel."""
        if name in self.made:
            return self.made[name]
        values = self.weights[name]
        if values.size not in (1, *values.shape[-1:]):
            raise self.refuse(node, f"takes a constant {values.shape}; wanted one number, or one for each channel")
        shape = () if values.size == 1 else (1, values.size, 1, 1)
        return self.graph.constant(f"{name}/{'x'.join(map(str, shape))}", values.reshape(shape))

    def mean(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        over = sorted(int(axis) % 4 for axis in self.weights[inputs[1]].ravel())
        if over != [1, 2] or not node["attr"]["keep_dims"]["b"]:
            raise self.refuse(node, f"is taken over the axes {over}; wanted rows and columns, kept with size 1")
        return self.graph.operation("GlobalAveragePool", [self.made[inputs[0]]], node["name"])

    def joined(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        if (axis := int(self.weights[inputs[-1]]) % 4) != 3:
            raise self.refuse(node, f"joins along axis {axis}; wanted 3, the channels")
        return self.graph.operation("Concat", [self.made[name] for name in inputs[:-1]], node["name"], axis=1)

    def resized(self, node: Mapping[str, Any], inputs: list[str]) -> str:
        size = self.weights[inputs[1]].astype(np.int64).ravel()
        corners, halves = (node["attr"].get(key, {}).get("b", False) for key in ("align_corners", "half_pixel_centers"))
        return self.graph.operation(
            "Resize", [self.made[inputs[0]], "", "", self.graph.constant(f"{node['name']}/size", size)], node["name"],
            mode="linear", axes=[2, 3],
            coordinate_transformation_mode="align_corners" if corners else "half_pixel" if halves else "asymmetric",
        )  # fmt: skip


def _text(node: Mapping[str, Any], key: str) -> str:
    return base64.b64decode(node["attr"][key]["s"]).decode()


def _list(node: Mapping[str, Any], key: str, kind: str) -> list[Any]:
    found = node["attr"].get(key, {}).get("list", {}).get(kind, [])
    return [int(value) for value in found] if kind == "i" else list(found)


_OPERATIONS: dict[str, Callable[[_Conversion, Mapping[str, Any], list[str]], str]] = {
    "Add": _Conversion.pairwise,
    "AddV2": _Conversion.pairwise,
    "ConcatV2": _Conversion.joined,
    "Conv2D": _Conversion.convolution,
    "DepthwiseConv2dNative": _Conversion.convolution,
    "FusedDepthwiseConv2dNative": _Conversion.convolution,
    "Identity": _Conversion.same,
    "Mean": _Conversion.mean,
    "Mul": _Conversion.pairwise,
    "Placeholder": _Conversion.placeholder,
    "Relu": _Conversion.activation,
    "Relu6": _Conversion.activation,
    "ResizeBilinear": _Conversion.resized,
    "Sigmoid": _Conversion.sigmoid,
    "_FusedConv2D": _Conversion.convolution,
}


# --- ONNX files -------------------------------------------------------------------------------------------------------

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
            dims = b"".join(_number_field(1, size) for size in values.shape)
            raw = np.asarray(values, values.dtype.newbyteorder("<")).tobytes()
            self._constants[name] = dims + _number_field(2, kind) + _text_field(8, name) + _bytes_field(9, raw)
        return name

    def operation(self, kind: str, inputs: Sequence[str], output: str, **attributes: Attribute) -> str:
        """Add the ONNX operator `kind`, and return the name of its one output. An input left out is an empty name."""
        named = (
            b"".join(_text_field(1, name) for name in inputs)
            + _text_field(2, output)
            + _text_field(3, output)
            + _text_field(4, kind)
        )
        written = b"".join(_bytes_field(5, _attribute_fields(key, value)) for key, value in sorted(attributes.items()))
        self._operations.append(named + written)
        return output

    def input(self, name: str, shape: Sequence[int]) -> str:
        """Add a float32 input, and return its name."""
        self._inputs.append(_tensor_fields(name, shape))
        return name

    def output(self, name: str, shape: Sequence[int]) -> None:
        """What is called `name` is an output, float32."""
        self._outputs.append(_tensor_fields(name, shape))

    def file(self, metadata: Mapping[str, str]) -> bytes:
        """The content of the ONNX file; the same graph always gives the same bytes."""
        graph = b"".join(_bytes_field(1, operation) for operation in self._operations) + _text_field(2, self.name)
        graph += b"".join(_bytes_field(5, constant) for constant in self._constants.values())
        graph += b"".join(_bytes_field(11, value) for value in self._inputs)
        graph += b"".join(_bytes_field(12, value) for value in self._outputs)
        notes = b"".join(_bytes_field(14, _text_field(1, key) + _text_field(2, text)) for key, text in metadata.items())
        operators = _bytes_field(8, _text_field(1, "") + _number_field(2, OPSET))
        return _number_field(1, IR_VERSION) + _text_field(2, "eagor") + _bytes_field(7, graph) + operators + notes


def _varint(number: int) -> bytes:
    """Seven bits to a byte, lowest first; negative ones as 64 bits."""
    number &= (1 << 64) - 1
    found = bytearray()
    while number > 0x7F:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


def _number_field(which: int, number: int) -> bytes:
    return _varint(which << 3) + _varint(number)


def _bytes_field(which: int, content: bytes) -> bytes:
    return _varint(which << 3 | 2) + _varint(len(content)) + content


def _text_field(which: int, text: str) -> bytes:
    return _bytes_field(which, text.encode())


def _attribute_fields(name: str, value: Attribute) -> bytes:
    if isinstance(value, str):
        return _text_field(1, name) + _text_field(4, value) + _number_field(20, _STRING)
    if isinstance(value, int):
        return _text_field(1, name) + _number_field(3, value) + _number_field(20, _INT)
    return _text_field(1, name) + b"".join(_number_field(8, each) for each in value) + _number_field(20, _INTS)


def _tensor_fields(name: str, shape: Sequence[int]) -> bytes:
    dims = b"".join(_bytes_field(1, _number_field(1, size)) for size in shape)
    tensor = _number_field(1, _ELEMENTS[np.dtype(np.float32)]) + _bytes_field(2, dims)
    return _text_field(1, name) + _bytes_field(2, _bytes_field(1, tensor))
