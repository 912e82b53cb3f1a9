"""Small graphs that were put together by hand: no torch was near them."""

import numpy as np
from onnx import ModelProto, TensorProto, helper, numpy_helper

FLOAT, UINT8 = TensorProto.FLOAT, TensorProto.UINT8
PICTURE = ["batch", 112, 112, 3]


def model(nodes, inputs, outputs, weights: dict[str, np.ndarray], header: str | None = None) -> ModelProto:
    """`nodes`: (operator, inputs, outputs, attributes); `inputs`, `outputs`: name, element type, shape."""
    graph = helper.make_graph(
        [helper.make_node(kind, given, made, **attributes) for kind, given, made, attributes in nodes],
        "handmade",
        [helper.make_tensor_value_info(*port) for port in inputs],
        [helper.make_tensor_value_info(*port) for port in outputs],
        [numpy_helper.from_array(values, name) for name, values in weights.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    if header is not None:
        helper.set_model_props(made, {"header": header})
    return made


def encoder(features: int = 30) -> ModelProto:
    """tanh of random sums of the means over 7 x 7 fields of the picture."""
    rng = np.random.default_rng(0)
    weights = {
        "matrix": rng.normal(size=(147, features), scale=3e-4).astype(np.float32),
        "rows": np.array([-1, 147], np.int64),
    }
    nodes = [
        ("Cast", ["picture"], ["numbers"], {"to": FLOAT}),
        ("Transpose", ["numbers"], ["planes"], {"perm": [0, 3, 1, 2]}),
        ("AveragePool", ["planes"], ["fields"], {"kernel_shape": [16, 16], "strides": [16, 16]}),
        ("Reshape", ["fields", "rows"], ["flat"], {}),
        ("MatMul", ["flat", "matrix"], ["sums"], {}),
        ("Tanh", ["sums"], ["features"], {}),
    ]
    return model(nodes, [("picture", UINT8, PICTURE)], [("features", FLOAT, ["batch", features])], weights)


def decoder(features: int = 30) -> ModelProto:
    """Red as the first feature is high, everywhere."""
    first = np.zeros((features, 3), np.float32)
    first[0, 0] = 127.5
    weights = {
        "first": first,
        "middle": np.array([127.5, 0.0, 0.0], np.float32),
        "pixel": np.array([-1, 1, 1, 3], np.int64),
        "shape": np.array([1, 112, 112, 3], np.int64),
    }
    nodes = [
        ("MatMul", ["features", "first"], ["red"], {}),
        ("Add", ["red", "middle"], ["colour"], {}),
        ("Cast", ["colour"], ["bytes"], {"to": UINT8}),
        ("Reshape", ["bytes", "pixel"], ["small"], {}),
        ("Expand", ["small", "shape"], ["picture"], {}),
    ]
    return model(nodes, [("features", FLOAT, ["batch", features])], [("picture", UINT8, PICTURE)], weights)


def policy(
    header: str | None, posture: int = 8, features: int = 30, horizon: int = 2, drift: float = 0.0
) -> ModelProto:
    """Predicts what it sees, plus a drift of the first joint; its state: the last `horizon` postures, newest first."""
    size = posture * horizon
    push = np.zeros((1, posture + features), np.float32)
    push[0, 0] = drift
    weights = {
        "push": push,
        "parts": np.array([posture, features], np.int64),
        "ages": np.array([size - posture, posture], np.int64),
        "shape": np.array([1, horizon, posture], np.int64),
    }
    nodes = [
        ("Add", ["x", "push"], ["y"], {}),
        ("Split", ["x", "parts"], ["now", "seen"], {"axis": 1}),
        ("Split", ["state", "ages"], ["kept", "oldest"], {"axis": 1}),
        ("Concat", ["now", "kept"], ["next_state"], {"axis": 1}),
        # What was the newest a tick ago is the first that is recalled.
        ("Reshape", ["state", "shape"], ["recalled"], {}),
    ]
    x, state = [1, posture + features], [1, size]
    return model(
        nodes,
        [("x", FLOAT, x), ("state", FLOAT, state)],
        [("y", FLOAT, x), ("next_state", FLOAT, state), ("recalled", FLOAT, [1, horizon, posture])],
        weights,
        header,
    )
