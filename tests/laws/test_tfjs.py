"""Laws of the conversion of TensorFlow.js graph models: the ONNX file computes what each operation means."""

import base64
import json

import numpy as np
import onnxruntime
import pytest

from eagor.perception.coco.tfjs import onnx_from_tfjs

RNG = np.random.default_rng(7)
SIZE = 9, 12  # of the pictures, unlike in rows and columns, and not a multiple of all strides
PICTURE = RNG.uniform(0, 8, size=(1, *SIZE, 3)).astype(np.float32)


# --- small models, as TensorFlow.js writes them ----------------------------------------------------------------------


def encoded(text):
    return {"s": base64.b64encode(text.encode()).decode()}


def integers(*values):
    return {"list": {"i": [str(value) for value in values]}}


def node(op, name, *inputs, **attr):
    return {"op": op, "name": name, "input": list(inputs), "attr": attr}


def convolution(op, name, *inputs, stride=1, padding="SAME", fused=()):
    return node(
        op, name, *inputs, padding=encoded(padding), strides=integers(1, stride, stride, 1),
        dilations=integers(1, 1, 1, 1), fused_ops={"list": {"s": [encoded(text)["s"] for text in fused]}},
    )  # fmt: skip


def model(nodes, weights, half=(), size=SIZE):
    """The two files of a graph model; weights whose names are in `half` are stored as float16."""
    dims = [{"size": str(each)} for each in (1, *size, 3)]
    nodes = [node("Placeholder", "in", shape={"shape": {"dim": dims}}), *nodes]
    nodes += [node("Const", name) for name in weights]
    manifest, data = [], b""
    for name, values in weights.items():
        entry = {"name": name, "shape": list(values.shape), "dtype": str(values.dtype)}
        if name in half:
            entry["quantization"] = {"dtype": "float16", "original_dtype": "float32"}
            values = values.astype(np.float16)
        manifest.append(entry)
        data += values.tobytes()
    described = {"modelTopology": {"node": nodes}, "weightsManifest": [{"paths": ["w.bin"], "weights": manifest}]}
    return json.dumps(described).encode(), data


def converted(nodes, weights, shape, half=(), metadata=None):
    """The ONNX file of that model, with one output of this `shape` (rows, columns, channels)."""
    files = model(nodes, weights, half)
    return onnx_from_tfjs(*files, {"out": ("found", (1, shape[2], shape[0], shape[1]))}, metadata or {})


def run(content, picture=PICTURE):
    """What the ONNX file gives for `picture` (1, h, w, 3), as (1, h, w, c)."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(None, {"images": picture.transpose(0, 3, 1, 2)})[0].transpose(0, 2, 3, 1)


def array(*shape):
    return RNG.normal(size=shape).astype(np.float32)


# --- what the operations mean, by NumPy ------------------------------------------------------------------------------


def padded(x, kernel, stride, padding, axis):
    """`x` with TensorFlow's zeros along `axis`: SAME gives ceil(n / stride) cells, and the odd zero goes behind."""
    if padding == "VALID":
        return x
    n = x.shape[axis]
    total = max((-(-n // stride) - 1) * stride + kernel - n, 0)
    return np.pad(x, [(total // 2, total - total // 2) if each == axis else (0, 0) for each in range(4)])


def convolve(x, kernel, stride=1, padding="SAME", by_channel=False):
    rows, columns = kernel.shape[:2]
    x = padded(padded(x, rows, stride, padding, 1), columns, stride, padding, 2)
    high, wide = (x.shape[1] - rows) // stride + 1, (x.shape[2] - columns) // stride + 1
    total = np.zeros(())
    for y in range(rows):
        for z in range(columns):
            part = x[:, y : y + (high - 1) * stride + 1 : stride, z : z + (wide - 1) * stride + 1 : stride]
            if by_channel:  # (channels, times): channel c gives the outputs c * times and following
                total = total + (part[..., None] * kernel[y, z]).reshape(*part.shape[:3], -1)
            else:
                total = total + part @ kernel[y, z]
    return total


def resize(x, size):
    for axis, new in ((1, size[0]), (2, size[1])):
        old = x.shape[axis]
        at = np.arange(new) * (old / new)
        low = np.clip(np.floor(at).astype(int), 0, old - 1)
        share = np.clip(at - low, 0, 1).reshape([-1 if each == axis else 1 for each in range(4)])
        x = x.take(low, axis) * (1 - share) + x.take(np.minimum(low + 1, old - 1), axis) * share
    return x


# --- laws ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("padding", ["SAME", "VALID"])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("op", ["Conv2D", "_FusedConv2D", "DepthwiseConv2dNative", "FusedDepthwiseConv2dNative"])
def test_convolutions(op, stride, padding):
    by_channel, fused = "Depthwise" in op, ("BiasAdd",) if "Fused" in op else ()
    kernel = array(3, 2, 3, 2) if by_channel else array(3, 2, 3, 5)
    weights = {"k": kernel} | ({"b": array(6 if by_channel else 5)} if fused else {})
    wanted = convolve(PICTURE, kernel, stride, padding, by_channel) + weights.get("b", 0)
    settings = {"stride": stride, "padding": padding, "fused": fused}
    content = converted([convolution(op, "out", "in", *weights, **settings)], weights, wanted.shape[1:])
    np.testing.assert_allclose(run(content), wanted, rtol=1e-5, atol=1e-4)


def test_an_operation_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="the operation 'TopKV2' of 'out' is not known here"):
        converted([node("TopKV2", "out", "in")], {}, (1, 1, 1))


def test_a_network_of_them_whose_weights_are_stored_in_half():
    weights = {
        "k1": array(3, 3, 3, 4), "b1": array(4), "k2": array(3, 3, 4, 1), "size": np.array([10, 18], np.int32),
        "scale": array(4), "half": np.array(0.5, np.float32), "axis": np.array(3, np.int32),
        "axes": np.array([1, 2], np.int32), "unused": array(2),
    }  # fmt: skip
    nodes = [  # not in the order in which they run
        node("Identity", "out", "sum", "^gate"),
        node("Add", "sum", "half", "gated"),
        node("Mul", "gated", "joined", "gate"),
        node("Sigmoid", "gate", "mean"),
        node("Mean", "mean", "joined", "axes", keep_dims={"b": True}),
        node("ConcatV2", "joined", "low", "high", "axis"),
        node("Relu", "low", "up"),
        node("Relu6", "high", "up"),
        node("ResizeBilinear", "up", "scaled", "size"),
        node("Mul", "scaled", "d", "scale"),
        convolution("DepthwiseConv2dNative", "d", "c", "k2"),
        convolution("_FusedConv2D", "c", "in", "k1", "b1", stride=2, fused=("BiasAdd", "Relu")),
        node("TopKV2", "not needed", "out"),
    ]
    half = ("k1", "b1", "k2", "unused")
    k1, b1, k2 = (weights[name].astype(np.float16).astype(np.float32) for name in ("k1", "b1", "k2"))
    x = np.maximum(convolve(PICTURE, k1, stride=2) + b1, 0)
    x = resize(convolve(x, k2, by_channel=True) * weights["scale"], (10, 18))
    x = np.concatenate([np.maximum(x, 0), np.clip(x, 0, 6)], 3)
    wanted = 0.5 + x / (1 + np.exp(-x.mean((1, 2), keepdims=True)))
    np.testing.assert_allclose(run(converted(nodes, weights, (10, 18, 8), half)), wanted, rtol=1e-4, atol=1e-3)


def test_the_file_says_what_it_takes_and_gives():
    content = converted([node("Relu", "out", "in")], {}, (*SIZE, 3), metadata={"names": '["a"]', "layout": "centernet"})
    session = onnxruntime.InferenceSession(content)
    (taken,), (given_,) = session.get_inputs(), session.get_outputs()
    assert (taken.name, taken.type, taken.shape) == ("images", "tensor(float)", [1, 3, *SIZE])
    assert (given_.name, given_.type, given_.shape) == ("found", "tensor(float)", [1, 3, *SIZE])
    assert session.get_modelmeta().custom_metadata_map == {"names": '["a"]', "layout": "centernet"}
