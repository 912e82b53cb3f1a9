"""The container of every network that runs: an ONNX graph with a JSON header, written in one go, checked when read.

A file from anywhere can be read without fear: it holds no code, only operators of ONNX's standard set, each of which
runs once, and everything it needs is inside, within bounds.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.files.container import FORMAT, RETRAIN, WeightsError, read_bytes, require_kind, write_bytes
from models.files.onnx_messages import parse_model

LARGEST = 100_000_000  # bytes of a file; the encoder has 19 million, in float32 75
HEADER = "header"  # the model's metadata entry that holds the JSON
_FLOATS = {1: np.float32, 10: np.float16, 11: np.float64}  # of TensorProto.DataType


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


def read_graph(path: str | Path, kind: str) -> Graph:
    """What write_graph wrote, or another tool; raises WeightsError unless it is a whole, harmless file of that kind."""
    content, model = _read(path)
    entries = {pair.key: pair.value for pair in model.metadata_props}
    if HEADER not in entries:
        raise WeightsError(path, f"has no metadata entry '{HEADER}'", "models/README.md says what belongs into it")
    try:
        header = dict(json.loads(entries[HEADER]))
    except (TypeError, ValueError) as error:
        raise WeightsError(path, f"has a damaged header ({error})", RETRAIN) from error
    require_kind(path, header, kind)
    return Graph(content, header)


def read_weights(path: str | Path) -> dict[str, np.ndarray]:
    """The floating point weights in the file, by name, as float32; raises WeightsError as read_graph."""
    return {tensor.name: _values(tensor).astype(np.float32) for tensor in _read(path)[1].graph.initializer
            if tensor.data_type in _FLOATS}  # fmt: skip


def _read(path: str | Path) -> tuple[bytes, Any]:
    content = read_bytes(path, LARGEST)
    try:
        model = parse_model(content)
        wrong = None if model.graph.node else "it holds no graph"
    except ValueError as error:
        wrong = str(error)
    if wrong is not None:
        raise WeightsError(path, f"the weight file is damaged ({wrong})", RETRAIN)
    _require_harmless(path, model)
    if not all(np.isfinite(_values(tensor)).all() for tensor in _tensors(model) if tensor.data_type in _FLOATS):
        raise WeightsError(path, "holds weights that are not finite", RETRAIN)
    return content, model


def _tensors(model: Any) -> list[Any]:
    attributes = [attribute for node in model.graph.node for attribute in node.attribute]
    inside = [tensor for attribute in attributes for tensor in (attribute.t, *attribute.tensors)]
    return [*model.graph.initializer, *inside]


def _values(tensor: Any) -> np.ndarray:
    """Of a floating point tensor, in its own precision."""
    kind = _FLOATS[tensor.data_type]
    values = np.frombuffer(tensor.raw_data, kind) if tensor.raw_data else np.array(
        tensor.float_data or tensor.double_data, kind)  # fmt: skip
    return values.reshape(tensor.dims) if values.size == np.prod(tensor.dims, dtype=int) else values


def _require_harmless(path: str | Path, model: Any) -> None:
    nodes = model.graph.node
    remedy = "Export it with operators of ONNX's standard set alone, everything in one file"
    if foreign := sorted({node.domain for node in nodes} - {"", "ai.onnx"}):
        raise WeightsError(path, f"needs operators of {', '.join(foreign)}", remedy)
    if model.functions or any(a.HasField("g") or a.graphs for node in nodes for a in node.attribute):
        raise WeightsError(path, "holds functions, branches or loops", remedy)
    if any(tensor.data_location or tensor.external_data for tensor in _tensors(model)):
        raise WeightsError(path, "keeps weights in another file", remedy)
