"""The container of what runs: what is written is read, and what could do harm is refused."""

import json

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from models.files import graphs
from models.files.container import WeightsError
from models.files.graphs import read_graph, weights_of, write_graph
from tests.models import handmade


def saved(tmp_path, change=lambda model: None, header=None):
    model = handmade.encoder()
    helper.set_model_props(model, {"header": json.dumps(header or {"kind": "encoder", "format": 1})})
    change(model)
    onnx.save(model, tmp_path / "x.onnx")
    return tmp_path / "x.onnx"


def test_a_file_gives_back_what_it_was_given(tmp_path):
    given = handmade.encoder()
    helper.set_model_props(given, {"author": "somebody"})
    for path in (tmp_path / "a.onnx", tmp_path / "b.onnx"):
        write_graph(path, given.SerializeToString(), {"kind": "encoder", "bounds": np.array([1.5, 2.0])})
    read = read_graph(tmp_path / "a.onnx", "encoder")
    assert read.header == {"kind": "encoder", "format": 1, "bounds": [1.5, 2.0]}
    assert read.hash == read_graph(tmp_path / "b.onnx", "encoder").hash  # same content, same hash
    model = onnx.load_from_string(read.content)
    onnx.checker.check_model(model, full_check=True)
    assert model.graph == given.graph  # also every field that our own reader does not know
    assert {entry.key for entry in model.metadata_props} == {"author", "header"}
    write_graph(tmp_path / "a.onnx", read.content, {"kind": "policy"})
    assert read_graph(tmp_path / "a.onnx", "policy").header == {"kind": "policy", "format": 1}


def test_weights_by_their_names(tmp_path):
    matrix = np.arange(6, dtype=np.float16).reshape(2, 3)
    listed = helper.make_tensor("listed", TensorProto.FLOAT, [2], [0.5, 1.5])

    def change(model):
        model.graph.initializer.extend([numpy_helper.from_array(matrix, "half"), listed])

    found = weights_of(read_graph(saved(tmp_path, change), "encoder"))
    assert set(found) == {"matrix", "half", "listed"}  # no shapes, which are integers
    assert {array.dtype for array in found.values()} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(found["half"], matrix)
    np.testing.assert_array_equal(found["listed"], [0.5, 1.5])


def custom(model):
    model.graph.node[5].domain = "com.microsoft"


def branch(model):
    model.graph.node.append(helper.make_node("If", ["x"], ["y"], then_branch=model.graph, else_branch=model.graph))


def function(model):
    node = helper.make_node("Tanh", ["a"], ["b"])
    opsets = [helper.make_opsetid("", 20)]
    model.functions.append(helper.make_function("mine", "Twice", ["a"], ["b"], [node], opsets))


def elsewhere(model):
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def not_finite(model):
    model.graph.initializer[0].CopyFrom(numpy_helper.from_array(np.full((147, 30), np.inf, np.float32), "matrix"))


def constant_not_finite(model):
    value = numpy_helper.from_array(np.array([np.nan], np.float32))
    model.graph.node.append(helper.make_node("Constant", [], ["c"], value=value))


def random(model):
    model.graph.node.append(helper.make_node("RandomNormalLike", ["x"], ["y"]))


def dropout_in_training(model):
    model.graph.node.append(helper.make_node("Dropout", ["x", "ratio", "training"], ["y"]))


def sparse(model):
    values = numpy_helper.from_array(np.ones(1, np.float32), "sparse")
    indices = numpy_helper.from_array(np.zeros(1, np.int64), "indices")
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(values, indices, [3]))


def hidden_float16(model):
    """NaN as whole numbers."""
    model.graph.initializer.append(TensorProto(name="x", dims=[1], data_type=TensorProto.FLOAT16, int32_data=[0x7E00]))


def bfloat16(model):
    model.graph.initializer.append(TensorProto(name="x", dims=[1], data_type=TensorProto.BFLOAT16, raw_data=b"\0\0"))


def fewer_numbers_than_its_shape(model):
    model.graph.initializer[0].raw_data = model.graph.initializer[0].raw_data[:5]


def negative_shape(model):
    model.graph.initializer[0].dims[:] = [-1, -1]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (random, r"draws random numbers \(RandomNormalLike\)"),
        (dropout_in_training, r"draws random numbers \(Dropout\)"),
        (sparse, "strange type"),
        (bfloat16, "strange type"),
        (hidden_float16, "not finite"),
        (fewer_numbers_than_its_shape, "damaged"),
        (negative_shape, "damaged .*matrix has 4410 numbers"),
        (custom, "needs operators of com.microsoft"),
        (branch, "holds functions, branches or loops"),
        (function, "holds functions, branches or loops"),
        (not_finite, "not finite"),
        (constant_not_finite, "not finite"),
    ],
)
def test_what_could_do_harm_is_refused(tmp_path, change, named):
    with pytest.raises(WeightsError, match=rf"x\.onnx: .*{named}"):
        read_graph(saved(tmp_path, change), "encoder")


def test_weights_in_another_file_are_refused(tmp_path):
    model = handmade.encoder()
    elsewhere(model)
    (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(WeightsError, match="keeps weights in another file"):
        read_graph(tmp_path / "x.onnx", "encoder")


def test_a_file_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(graphs, "LARGEST", 1000)
    with pytest.raises(WeightsError, match=r"x\.onnx: has \d+ bytes, more than the 1000"):
        read_graph(saved(tmp_path), "encoder")


@pytest.mark.parametrize("keep", [0, 5, 1000, -100])
def test_damaged_file(tmp_path, keep):
    path = saved(tmp_path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(WeightsError, match=r"x\.onnx: .*(damaged|no metadata entry)"):
        read_graph(path, "encoder")


def test_header_that_is_absent_damaged_or_of_another_kind(tmp_path):
    onnx.save(handmade.encoder(), tmp_path / "y.onnx")
    with pytest.raises(WeightsError, match=r"no metadata entry 'header'.*README"):
        read_graph(tmp_path / "y.onnx", "encoder")
    onnx.save(handmade.policy("{3"), tmp_path / "y.onnx")
    with pytest.raises(WeightsError, match="damaged"):
        read_graph(tmp_path / "y.onnx", "policy")
    for header in ("3", "[" * 100_000):
        onnx.save(handmade.policy(header), tmp_path / "y.onnx")
        with pytest.raises(WeightsError, match=r"y\.onnx: the weight file is damaged"):
            read_graph(tmp_path / "y.onnx", "policy")
    with pytest.raises(WeightsError, match=r"kind 'decoder', format 1, where kind 'encoder'"):
        read_graph(saved(tmp_path, header={"kind": "decoder", "format": 1}), "encoder")
    with pytest.raises(WeightsError, match=r"kind 'encoder', format 2"):
        read_graph(saved(tmp_path, header={"kind": "encoder", "format": 2}), "encoder")


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = saved(tmp_path)
    before = path.read_bytes()
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_graph(path, handmade.decoder().SerializeToString(), {"kind": "decoder"})
    assert path.read_bytes() == before
