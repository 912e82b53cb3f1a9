"""The container of every network that runs: an ONNX graph with a JSON header, written in one go, checked when read.

A file from elsewhere holds no code and names no other file: only operators of ONNX's standard set, each of which runs
once and draws no random number, and finite weights. What they make of memory and time, only running them shows.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.files.container import FORMAT, WeightsError, read_bytes, require_kind, write_bytes
from models.files.onnx_messages import parse_model

LARGEST = 100_000_000  # bytes of a file; the encoder has 19 million, in float32 75
HEADER = "header"  # the model's metadata entry that holds the JSON
REMEDY = "Take it from the repository again (git checkout), or make it as models/README.md says"
# Of TensorProto.DataType: floating point numbers; whole numbers and booleans.
_FLOATS, _WHOLE = {1: np.float32, 10: np.float16, 11: np.float64}, {2, 3, 4, 5, 6, 7, 9, 12, 13}
_RANDOM = ("Random", "Bernoulli", "Multinomial")  # beginnings of the names of operators


@dataclass(frozen=True)
class Graph:
    """A file's bytes, for the runtime, its header, and its hash."""

    content: bytes
    header: dict[str, Any]

    @property
    def hash(self) -> str:
        """SHA-256 of the file, hexadecimal."""
        return hashlib.sha256(self.content).hexdigest()


def write_graph(path: str | Path, content: bytes, header: dict[str, Any]) -> None:
    """Writes an ONNX model with a header of plain types and arrays with its `kind`; takes the place of another one."""
    model = parse_model(content)
    kept = [(pair.key, pair.value) for pair in model.metadata_props if pair.key != HEADER]
    del model.metadata_props[:]
    text = json.dumps({"format": FORMAT} | header, sort_keys=True, default=lambda array: array.tolist())
    for key, value in [*kept, (HEADER, text)]:
        model.metadata_props.add(key=key, value=value)
    write_bytes(path, model.SerializeToString(deterministic=True))


def read_graph(path: str | Path, kind: str, content: bytes | None = None) -> Graph:
    """What write_graph wrote, or another tool; raises WeightsError unless it is a whole, harmless file of that kind.

    `content`: of the file, where it has been read already.
    """
    content = read_bytes(path, LARGEST) if content is None else content
    try:
        model = parse_model(content)
        if not model.graph.node:
            raise ValueError("it holds no graph")
        _require_harmless(path, model)
        entries = {pair.key: pair.value for pair in model.metadata_props}
        if HEADER not in entries:
            raise WeightsError(
                path, f"has no metadata entry '{HEADER}'", "Add it: models/README.md says what belongs there"
            )
        header = dict(json.loads(entries[HEADER]))
    except WeightsError:
        raise
    except (RecursionError, TypeError, ValueError) as error:
        raise WeightsError(path, f"the weight file is damaged ({error})", REMEDY) from error
    require_kind(path, header, kind)
    return Graph(content, header)


def weights_of(graph: Graph) -> dict[str, np.ndarray]:
    """The floating point weights in a graph that read_graph gave, by name, as float32."""
    tensors = parse_model(graph.content).graph.initializer
    return {t.name: _values(t).astype(np.float32).reshape(t.dims) for t in tensors if t.data_type in _FLOATS}


def _values(tensor: Any) -> np.ndarray:
    """Of a floating point tensor, flat, in its own precision; raises ValueError where its shape asks for others."""
    kind, listed = _FLOATS[tensor.data_type], tensor.float_data or tensor.double_data
    values = np.array(listed, kind) if listed else np.frombuffer(tensor.raw_data, kind)
    if kind is np.float16 and tensor.int32_data:  # their bits
        values = np.array(tensor.int32_data, np.uint16).view(kind)
    if values.size != np.prod(tensor.dims, dtype=int):
        raise ValueError(f"{tensor.name} has {values.size} numbers for the shape {list(tensor.dims)}")
    return values


def _require_harmless(path: str | Path, model: Any) -> None:
    nodes, attributes = model.graph.node, [a for node in model.graph.node for a in node.attribute]
    tensors = [*model.graph.initializer, *(t for a in attributes for t in ([a.t] if a.HasField("t") else a.tensors))]
    sparse = model.graph.sparse_initializer or any(a.sparse_tensor or a.sparse_tensors for a in attributes)
    foreign = sorted({node.domain for node in nodes} - {"", "ai.onnx"})
    training = [node.op_type for node in nodes if node.op_type == "Dropout" and len(node.input) > 2]
    chance = training + [node.op_type for node in nodes if node.op_type.startswith(_RANDOM)]
    for found, wrong in (
        (foreign, f"needs operators of {', '.join(foreign)}"),
        (chance, f"draws random numbers ({', '.join(chance)})"),
        (model.functions or any(a.HasField("g") or a.graphs for a in attributes), "holds functions, branches or loops"),
        (any(t.data_location or t.external_data for t in tensors), "keeps weights in another file"),
        (sparse or any(t.data_type not in _WHOLE | _FLOATS.keys() for t in tensors), "holds weights of a strange type"),
    ):
        if found:
            remedy = "Export it with operators of ONNX's standard set alone, everything in one file"
            raise WeightsError(path, wrong, remedy)
    if not all(np.isfinite(_values(tensor)).all() for tensor in tensors if tensor.data_type in _FLOATS):
        raise WeightsError(path, "holds weights that are not finite", REMEDY)
