"""Detectors in ONNX files that ask for too much: time, room, or other files. Each ends in an error that says it."""

import os

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx_files import onnx_file

from eagor.errors import EagorError
from eagor.perception.onnx import OnnxDetector, decoding, network

NAMES = {"names": str({number: f"thing {number}" for number in range(80)})}
TABLE = np.zeros((1, 84, 100), np.float32)


def endless(path):
    """Adds one to a number, for ever."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go on"], ["again"]), helper.make_node("Add", ["x", "step"], ["y"])],
        "body",
        [helper.make_tensor_value_info("at", TensorProto.INT64, []),
         helper.make_tensor_value_info("go on", TensorProto.BOOL, []),
         helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])],
        [helper.make_tensor_value_info("again", TensorProto.BOOL, []),
         helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])],
        [numpy_helper.from_array(np.ones(1, np.float32), "step")],
    )  # fmt: skip
    inits = [
        numpy_helper.from_array(np.array(value, dtype), name)
        for name, value, dtype in [("most", 2**62, np.int64), ("begin", True, np.bool_), ("zero", [0], np.float32)]
    ]
    loop = helper.make_node("Loop", ["most", "begin", "zero"], ["output0"], body=body)
    return onnx_file(path, {"output0": None}, nodes=[loop], inits=inits)


def test_a_network_that_does_not_end(tmp_path, monkeypatch):
    monkeypatch.setattr(network, "SECONDS", 0.2)
    with pytest.raises(EagorError, match=r"64 x 64: it has not ended after 0\.2 seconds; a smaller size"):
        OnnxDetector(endless(tmp_path / "endless.onnx"))


@pytest.mark.parametrize(("rows", "columns"), [(200_000, 200_000), (8192, 8192), (64, 9000)])
def test_an_input_that_is_too_large(tmp_path, rows, columns):
    file = onnx_file(tmp_path / "large.onnx", {"output0": TABLE}, (1, 3, rows, columns), notes=NAMES)
    with pytest.raises(EagorError, match=f"takes pictures of {columns} x {rows}; wanted at most 8192"):
        OnnxDetector(file)
    free = onnx_file(tmp_path / "free.onnx", {"output0": TABLE}, (1, 3, None, None), notes=NAMES)
    with pytest.raises(EagorError, match=r"wanted at most 8192|wanted pixels, 8 to 8192"):
        OnnxDetector(free, size=(rows, columns))


def test_outputs_that_are_too_large(tmp_path):
    """Refused before it runs where the file says so, else after it ran."""
    shape = numpy_helper.from_array(np.array([1, 84, 500_000]), "shape")
    fill = helper.make_node("ConstantOfShape", ["shape"], ["output0"])
    file = onnx_file(tmp_path / "told.onnx", {"output0": None}, notes=NAMES, nodes=[fill], inits=[shape])
    with pytest.raises(EagorError, match="gives 42000000 numbers for a picture; wanted at most 33554432"):
        OnnxDetector(file)
    count = helper.make_node("ReduceMax", ["images"], ["one"], keepdims=0)
    nodes = [
        count, helper.make_node("Mul", ["one", "many"], ["sides"]),
        helper.make_node("Cast", ["sides"], ["shape"], to=TensorProto.INT64),
        helper.make_node("ConstantOfShape", ["shape"], ["output0"]),
    ]  # fmt: skip
    many = numpy_helper.from_array(np.array([3, 400_000, 600], np.float32), "many")  # times the grey, 114 / 255
    file = onnx_file(tmp_path / "found.onnx", {"output0": None}, notes=NAMES, nodes=nodes, inits=[many])
    with pytest.raises(EagorError, match=r"gives \d+ numbers for a picture; wanted at most"):
        OnnxDetector(file)


def test_of_very_many_boxes_the_best_are_read_on(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    table = np.concatenate([rng.uniform(0, 64, (4, 500)), rng.uniform(0.3, 1, (80, 500))]).astype(np.float32)[None]
    detect = OnnxDetector(onnx_file(tmp_path / "d.onnx", {"output0": table}, notes=NAMES), layout="yolov8")
    picture = np.zeros((64, 64, 3), np.uint8)
    all_of_them = detect(picture)
    monkeypatch.setattr(decoding, "MOST_READ", 5000)
    for one, other in zip(detect(picture), all_of_them, strict=True):
        assert np.array_equal(one, other)
    monkeypatch.setattr(decoding, "MOST_READ", 10)
    assert np.array_equal(detect(picture)[1], all_of_them[1][: len(detect(picture)[1])])


def with_weights(path, location):
    """A detector whose answer lies in another file."""
    weights = numpy_helper.from_array(TABLE, "value")
    weights.ClearField("raw_data")
    weights.data_location = TensorProto.EXTERNAL
    weights.external_data.add(key="location", value=location)
    weights.external_data.add(key="length", value=str(TABLE.nbytes))
    graph = helper.make_graph(
        [helper.make_node("Identity", ["value"], ["output0"])], "detector",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, 64, 64))],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, TABLE.shape)], [weights],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, NAMES)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize("location", ["weights.bin", "inner/weights.bin", "way/secret.bin", "pipe"])
def test_weights_out_of_the_folder_are_not_read(tmp_path, monkeypatch, location):
    folder, secret = tmp_path / "model", tmp_path / "secret.bin"
    secret.write_bytes(TABLE.tobytes())
    (folder / "inner").mkdir(parents=True)
    (folder / "weights.bin").symlink_to(secret)
    (folder / "inner" / "weights.bin").symlink_to(secret)
    (folder / "way").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe")
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it is opened"))
    with pytest.raises(EagorError, match=r"cannot be opened as an ONNX model \(it names .* which is a link out of its"):
        OnnxDetector(with_weights(folder / "model.onnx", location))


def test_weights_in_the_folder_and_in_caches_are_read(tmp_path):
    """Caches keep files under their hash in one folder, and a folder of links for each version."""
    (tmp_path / "blobs").mkdir()
    (tmp_path / "version").mkdir()
    (tmp_path / "blobs" / "1a2b").write_bytes(TABLE.tobytes())
    (tmp_path / "other").symlink_to(tmp_path / "blobs")
    for folder in ("blobs", "version"):
        with_weights(tmp_path / "blobs" / "3c4d", "1a2b" if folder == "blobs" else "weights.bin")
        if folder == "version":
            (tmp_path / "version" / "weights.bin").symlink_to(tmp_path / "blobs" / "1a2b")
            (tmp_path / "version" / "model.onnx").symlink_to(tmp_path / "blobs" / "3c4d")
        file = tmp_path / "blobs" / "3c4d" if folder == "blobs" else tmp_path / "version" / "model.onnx"
        assert OnnxDetector(file).classes[79] == "thing 79"
