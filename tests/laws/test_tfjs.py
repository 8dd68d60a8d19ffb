"""Laws of the conversion of TensorFlow.js graph models: the ONNX file computes what each operation means."""

import base64
import json

import numpy as np
import onnxruntime
import pytest

from eagor.perception.coco.tfjs import Output, onnx_from_tfjs

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


def converted(nodes, weights, shape, half=(), out="out", metadata=None):
    """The ONNX file of that model, with one output of this `shape` (rows, columns, channels)."""
    files = model(nodes, weights, half)
    output = Output(out, "found", (1, shape[2], shape[0], shape[1]))
    return onnx_from_tfjs(*files, (output,), metadata or {}, "small")


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
@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("op", ["Conv2D", "_FusedConv2D", "DepthwiseConv2dNative", "FusedDepthwiseConv2dNative"])
def test_convolutions(op, stride, padding):
    by_channel, fused = "Depthwise" in op, ("BiasAdd",) if "Fused" in op else ()
    kernel = array(3, 2, 3, 2) if by_channel else array(3, 2, 3, 5)
    weights = {"k": kernel} | ({"b": array(6 if by_channel else 5)} if fused else {})
    wanted = convolve(PICTURE, kernel, stride, padding, by_channel) + weights.get("b", 0)
    settings = {"stride": stride, "padding": padding, "fused": fused}
    content = converted([convolution(op, "out", "in", *weights, **settings)], weights, wanted.shape[1:])
    np.testing.assert_allclose(run(content), wanted, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    ("fused", "after"),
    [
        (("Relu",), lambda x: np.maximum(x, 0)),
        (("BiasAdd", "Relu"), lambda x: np.maximum(x + 1, 0)),
    ],
)
def test_what_is_fused_follows(fused, after):
    weights = {"k": array(1, 1, 3, 4), "b": np.ones(4, np.float32)}
    inputs = ("k", "b") if "BiasAdd" in fused else ("k",)
    content = converted([convolution("_FusedConv2D", "out", "in", *inputs, fused=fused)], weights, (*SIZE, 4))
    np.testing.assert_allclose(run(content), after(PICTURE @ weights["k"][0, 0]), rtol=1e-5, atol=1e-4)


CHANNELS = array(3)
BY_ELEMENTS = {
    "Relu": ([node("Add", "a", "in", "c"), node("Relu", "out", "a")], np.float32(-4), lambda x: np.maximum(x - 4, 0)),
    "Relu6": ([node("Relu6", "out", "in")], np.float32(0), lambda x: np.clip(x, 0, 6)),
    "Sigmoid": ([node("Sigmoid", "out", "in")], np.float32(0), lambda x: 1 / (1 + np.exp(-x))),
    "Identity": ([node("Identity", "out", "in")], np.float32(0), lambda x: x),
    "Add, a constant first": ([node("Add", "out", "c", "in")], np.float32(2), lambda x: 2 + x),
    "Add, by channel": ([node("Add", "out", "in", "c")], CHANNELS, lambda x: x + CHANNELS),
    "Mul, by channel": ([node("Mul", "out", "in", "c")], CHANNELS[None, None, None], lambda x: x * CHANNELS),
    "Mul, with itself": ([node("Mul", "out", "in", "in")], np.float32(0), lambda x: x * x),
    "Mul, after a control input": ([node("Mul", "out", "in", "c", "^in")], np.float32(3), lambda x: 3 * x),
}


@pytest.mark.parametrize("name", BY_ELEMENTS)
def test_operations_by_elements(name):
    nodes, constant, meaning = BY_ELEMENTS[name]
    content = converted(nodes, {"c": np.asarray(constant)}, (*SIZE, 3))
    np.testing.assert_allclose(run(content), meaning(PICTURE), rtol=1e-6)


@pytest.mark.parametrize("axes", [(1, 2), (-2, -3)])
def test_means_are_over_the_picture_and_spread_over_it_again(axes):
    nodes = [node("Mean", "m", "in", "axes", keep_dims={"b": True}), node("Mul", "out", "m", "in")]
    content = converted(nodes, {"axes": np.array(axes, np.int32)}, (*SIZE, 3))
    np.testing.assert_allclose(run(content), PICTURE * PICTURE.mean((1, 2), keepdims=True), rtol=1e-5)


@pytest.mark.parametrize("axis", [3, -1])
def test_channels_are_joined(axis):
    nodes = [node("Relu6", "a", "in"), node("ConcatV2", "out", "in", "a", "in", "axis")]
    content = converted(nodes, {"axis": np.array(axis, np.int32)}, (*SIZE, 9))
    np.testing.assert_allclose(run(content), np.concatenate([PICTURE, np.clip(PICTURE, 0, 6), PICTURE], 3))


@pytest.mark.parametrize("size", [(18, 24), (27, 12), (18, 18)])
def test_pictures_are_resized(size):
    nodes = [node("ResizeBilinear", "out", "in", "size")]
    content = converted(nodes, {"size": np.array(size, np.int32)}, (*size, 3))
    np.testing.assert_allclose(run(content), resize(PICTURE, size), rtol=1e-4, atol=1e-5)


def test_a_network_of_them_whose_weights_are_stored_in_half():
    weights = {
        "k1": array(3, 3, 3, 4), "b1": array(4), "k2": array(3, 3, 4, 1), "size": np.array([9, 12], np.int32),
        "axis": np.array(3, np.int32), "axes": np.array([1, 2], np.int32), "unused": array(2),
    }  # fmt: skip
    nodes = [  # not in the order in which they run
        node("Identity", "out", "sum"),
        node("Add", "sum", "joined", "gate"),
        node("Sigmoid", "gate", "mean"),
        node("Mean", "mean", "joined", "axes", keep_dims={"b": True}),
        node("ConcatV2", "joined", "up", "up", "axis"),
        node("ResizeBilinear", "up", "d", "size"),
        convolution("DepthwiseConv2dNative", "d", "c", "k2"),
        convolution("_FusedConv2D", "c", "in", "k1", "b1", stride=2, fused=("BiasAdd", "Relu")),
        node("TopKV2", "not needed", "out"),
    ]
    half = ("k1", "b1", "k2", "unused")
    k1, b1, k2 = (weights[name].astype(np.float16).astype(np.float32) for name in ("k1", "b1", "k2"))
    x = np.maximum(convolve(PICTURE, k1, stride=2) + b1, 0)
    x = resize(convolve(x, k2, by_channel=True), (9, 12))
    x = np.concatenate([x, x], 3)
    wanted = x + 1 / (1 + np.exp(-x.mean((1, 2), keepdims=True)))
    content = converted(nodes, weights, (9, 12, 8), half)
    np.testing.assert_allclose(run(content), wanted, rtol=1e-4, atol=1e-3)
    assert content == converted(nodes, weights, (9, 12, 8), half), "the same bytes each time"


def test_the_file_says_what_it_takes_and_gives():
    content = converted([node("Relu", "out", "in")], {}, (*SIZE, 3), metadata={"names": '["a"]', "layout": "centernet"})
    session = onnxruntime.InferenceSession(content)
    (taken,), (given_,) = session.get_inputs(), session.get_outputs()
    assert (taken.name, taken.type, taken.shape) == ("images", "tensor(float)", [1, 3, *SIZE])
    assert (given_.name, given_.type, given_.shape) == ("found", "tensor(float)", [1, 3, *SIZE])
    assert session.get_modelmeta().custom_metadata_map == {"names": '["a"]', "layout": "centernet"}
