"""The container of what is learned but no graph: safetensors with a JSON header."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from models.files.container import FORMAT, WeightsError, require_kind, write_bytes


def write_tensors(path: str | Path, tensors: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Writes arrays and a header of plain types and arrays with its `kind`; the file gets its name only when whole."""
    # One string: safetensors writes several in random order, and the same content would get another hash each time.
    text = json.dumps({"format": FORMAT} | header, sort_keys=True, default=lambda array: array.tolist())
    whole = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
    write_bytes(path, save(whole, {"header": text}))


def read_tensors(path: str | Path, kind: str, remedy: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """What write_tensors wrote; raises WeightsError unless the file is there, whole, finite and of that kind.

    `remedy`: where to get a good one.
    """
    if not Path(path).is_file():
        raise WeightsError(path, "the weight file does not exist", remedy)
    try:
        with safe_open(path, "np") as file:
            header = dict(json.loads((file.metadata() or {}).get("header", "{}")))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (RecursionError, SafetensorError, OSError, TypeError, ValueError) as error:
        raise WeightsError(path, f"the weight file is damaged ({error})", remedy) from error
    require_kind(path, header, kind)
    if not all(np.isfinite(value).all() for value in tensors.values() if value.dtype.kind == "f"):
        raise WeightsError(path, "holds weights that are not finite", remedy)
    return tensors, header
