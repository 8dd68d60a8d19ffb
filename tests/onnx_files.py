"""Small ONNX files for tests: networks whose outputs are stated, or follow from the picture by one operation."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

KINDS = {"float32": TensorProto.FLOAT, "float16": TensorProto.FLOAT16, "uint8": TensorProto.UINT8,
         "int64": TensorProto.INT64, "int32": TensorProto.INT32}  # fmt: skip


def onnx_file(path, outputs, shape=(1, 3, 64, 64), kind="float32", notes=(), further=(), nodes=(), inits=()):
    """Write a network to `path` that answers every picture with the arrays `outputs`, by name; returns the path.

    `shape`: of the input, None where any will do. `further`: inputs besides, (name, shape, kind). `nodes`, `inits`:
    operations that make outputs given as None.
    """
    made, values = list(nodes), list(inits)
    described = []
    for name, array in outputs.items():
        if array is None:
            described.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, None))
            continue
        array = np.asarray(array)
        values.append(numpy_helper.from_array(array, f"value of {name}"))
        made.append(helper.make_node("Identity", [f"value of {name}"], [name]))
        described.append(helper.make_tensor_value_info(name, KINDS[str(array.dtype)], array.shape))
    sides = [f"side{at}" if each is None else each for at, each in enumerate(shape)]
    inputs = [helper.make_tensor_value_info("images", KINDS[kind], sides)]
    inputs += [helper.make_tensor_value_info(name, KINDS[k], s) for name, s, k in further]
    graph = helper.make_graph(made, "detector", inputs, described, values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, dict(notes))
    onnx.save(model, str(path))
    return path


def seeing_file(path, size=64, stride=4):
    """A CenterNet that sees: the score of its one class is how red a cell is; boxes are 8 x 6 pixels about its corner.

    It wants RGB, 0 to 255.
    """
    rows = size // stride
    distances = np.broadcast_to(np.array([4, 3, 4, 3], np.float32)[:, None, None], (4, rows, rows))[None]
    nodes = [
        helper.make_node("Mul", ["images", "share"], ["parts"]),
        helper.make_node("ReduceSum", ["parts", "axes"], ["red"], keepdims=1),
        helper.make_node("AveragePool", ["red"], ["raw"], kernel_shape=[stride] * 2, strides=[stride] * 2),
        helper.make_node("Clip", ["raw", "least", "most"], ["scores"]),
    ]
    share = np.array([1, -0.5, -0.5], np.float32).reshape(1, 3, 1, 1) / 255
    inits = [
        numpy_helper.from_array(np.array(value, dtype), name)
        for name, value, dtype in [("share", share, np.float32), ("axes", [1], np.int64), ("least", 0, np.float32),
                                   ("most", 1, np.float32)]
    ]  # fmt: skip
    outputs = {"scores": None, "distances": distances.astype(np.float32)}
    return onnx_file(path, outputs, (1, 3, size, size), nodes=nodes, inits=inits)
