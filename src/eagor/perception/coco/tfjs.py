"""The network's TensorFlow.js graph model as an ONNX file.

A graph model is a JSON file (operations, and a list of weights) and a file with the weights. Its pictures are laid out
``(1, h, w, c)``, those of ONNX ``(1, c, h, w)``. Only the operations of this one network are known here.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper

__all__ = ["onnx_from_tfjs"]

IR_VERSION, OPSET = 8, 18  # ONNX 1.13: onnxruntime reads it since 1.14
_SAME = {"Add", "Mul", "Relu", "Sigmoid", "Identity"}  # operations that ONNX has, too
_PADDING = {b"SAME": "SAME_UPPER", b"VALID": "VALID"}


def onnx_from_tfjs(
    model: bytes, weights: bytes, outputs: Mapping[str, tuple[str, Sequence[int]]], metadata: Mapping[str, str]
) -> bytes:
    """The ONNX file for a TensorFlow.js graph model, given its two files.

    The one input is called ``images``, float32 ``(1, 3, h, w)``. `outputs`: for each name in the original its name and
    its shape in the ONNX file. `metadata` goes into the file.
    """
    described = json.loads(model)
    graph = _Graph(described["modelTopology"]["node"], _weights(described["weightsManifest"], weights))
    for original, (name, _) in outputs.items():
        graph.add("Identity", [graph.convert(original)], name)
    results = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.values()]
    made = helper.make_model(
        helper.make_graph(graph.operations, "tfjs", graph.inputs, results, [*graph.constants.values()]),
        opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="eagor",
    )  # fmt: skip
    helper.set_model_props(made, dict(metadata))
    checker.check_model(made)
    return made.SerializeToString(deterministic=True)


def _weights(manifest: Sequence[Mapping[str, Any]], data: bytes) -> dict[str, np.ndarray]:
    """The arrays in `data`, by name: float32 (also those that are stored as float16) and int32."""
    arrays, at = {}, 0
    for entry in (entry for group in manifest for entry in group["weights"]):
        kind = np.dtype(entry.get("quantization", entry)["dtype"]).newbyteorder("<")
        values = np.frombuffer(data, kind, int(np.prod(entry["shape"])), at)
        arrays[entry["name"]] = values.reshape(entry["shape"]).astype(entry["dtype"])
        at += values.nbytes
    return arrays


class _Graph:
    """The ONNX graph in the making; `made`: the name in it of what each node of the original gives."""

    def __init__(self, nodes: Sequence[Mapping[str, Any]], weights: Mapping[str, np.ndarray]) -> None:
        self.nodes, self.weights = {node["name"]: node for node in nodes}, weights
        self.operations: list[Any] = []
        self.constants: dict[str, Any] = {}
        self.inputs: list[Any] = []
        self.made: dict[str, str] = {}

    def add(self, kind: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Add the ONNX operator `kind`, and return the name of its one output. An input left out is an empty name."""
        self.operations.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def constant(self, name: str, values: np.ndarray) -> str:
        """Keep `values` under `name`, once, and return the name."""
        self.constants[name] = numpy_helper.from_array(np.ascontiguousarray(values), name)
        return name

    def convert(self, name: str) -> str:
        """Add a node, after those that it needs, unless it is there; the name of what it gives."""
        if name not in self.made:
            node = self.nodes[name]
            inputs = [each for each in node.get("input", []) if not each.startswith("^")]  # "^" says only: after it
            self.made[name] = self._converted(node["op"], node.get("attr", {}), name, inputs)
        return self.made[name]

    def _converted(self, kind: str, attributes: Mapping[str, Any], name: str, inputs: Sequence[str]) -> str:
        if kind == "Placeholder":
            _, rows, columns, channels = (int(dim["size"]) for dim in attributes["shape"]["shape"]["dim"])
            self.inputs.append(helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, channels, rows, columns)))
            return "images"
        if kind == "Const":  # an operand by elements: one number, or one for each channel
            values = self.weights[name]
            return self.constant(name, values.reshape(() if values.size == 1 else (1, values.size, 1, 1)))
        if "Conv2" in kind:  # plain, by channel, with or without the bias and the ReLU that are fused with it
            kernel, group = self.weights[inputs[1]], 1  # (rows, columns, from, to), or (rows, columns, channels, times)
            if "Depthwise" in kind:
                group, kernel = kernel.shape[2], kernel.transpose(2, 3, 0, 1).reshape(-1, 1, *kernel.shape[:2])
            else:
                kernel = kernel.transpose(3, 2, 0, 1)
            operands = [self.convert(inputs[0]), self.constant(f"{name}/kernel", kernel)]
            fused = [base64.b64decode(text) for text in attributes.get("fused_ops", {}).get("list", {}).get("s", [])]
            if b"BiasAdd" in fused:
                operands.append(self.constant(f"{name}/bias", self.weights[inputs[2]]))
            how: dict[str, Any] = {
                key: [*map(int, attributes[key]["list"]["i"][1:3])] for key in ("strides", "dilations")
            }
            how |= {"auto_pad": _PADDING[base64.b64decode(attributes["padding"]["s"])], "group": group}
            if b"Relu" not in fused:
                return self.add("Conv", operands, name, **how)
            return self.add("Relu", [self.add("Conv", operands, f"{name}/convolved", **how)], name)
        first = self.convert(inputs[0])
        if kind in _SAME:
            return self.add(kind, [first, *map(self.convert, inputs[1:])], name)
        if kind == "Relu6":
            bounds = [self.constant(f"clip/{bound}", np.array(bound, np.float32)) for bound in (0, 6)]
            return self.add("Clip", [first, *bounds], name)
        if kind == "Mean":  # over rows and columns, which are kept with size 1
            return self.add("GlobalAveragePool", [first], name)
        if kind == "ConcatV2":  # of the channels; the last input is the axis
            return self.add("Concat", [first, *map(self.convert, inputs[1:-1])], name, axis=1)
        if kind == "ResizeBilinear":
            size = self.constant(f"{name}/size", self.weights[inputs[1]].astype(np.int64).ravel())
            where = {"mode": "linear", "axes": [2, 3], "coordinate_transformation_mode": "asymmetric"}
            return self.add("Resize", [first, "", "", size], name, **where)
        raise ValueError(f"the operation {kind!r} of {name!r} is not known here")
