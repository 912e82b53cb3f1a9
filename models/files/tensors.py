"""The container of every weight file: safetensors with a JSON header, written in one go and checked when read."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from models.errors import InputError

FORMAT = 1
RETRAIN = "Take the file from the repository again (git checkout), or train it with `python -m models.training`"


class WeightsError(InputError):
    """A weight file is missing, damaged, or of another kind than asked for. Arguments: path, what is wrong, remedy."""

    def __str__(self) -> str:
        path, wrong, remedy = self.args
        return f"{path}: {wrong}. {remedy}"


def file_hash(path: str | Path) -> str:
    """SHA-256 of the file, hexadecimal; raises WeightsError where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError as error:
        raise WeightsError(path, "the weight file does not exist", RETRAIN) from error
    except OSError as error:
        raise WeightsError(
            path, f"the weight file cannot be read ({error.strerror})", "Check its permissions"
        ) from error


def write_tensors(path: str | Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Writes tensors and a header of plain types and arrays with its `kind`; the file gets its name only when whole."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    # One string: safetensors writes several in random order, and the same content would get another hash each time.
    text = json.dumps({"format": FORMAT} | header, sort_keys=True, default=lambda array: array.tolist())
    save_file(tensors, partial, {"header": text})
    partial.chmod(0o644)
    os.replace(partial, path)


def read_tensors(path: str | Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What write_tensors wrote; raises WeightsError unless the file is there, whole, finite and of that kind."""
    if not Path(path).is_file():
        raise WeightsError(path, "the weight file does not exist", RETRAIN)
    try:
        with safe_open(path, "pt") as file:
            header = dict(json.loads((file.metadata() or {}).get("header", "{}")))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, TypeError, ValueError) as error:
        raise WeightsError(path, f"the weight file is damaged ({error})", RETRAIN) from error
    have, wanted = (header.get("kind"), header.get("format")), (kind, FORMAT)
    if have != wanted:
        wrong = f"is a file of kind {have[0]!r}, format {have[1]!r}, where kind {kind!r}, format {FORMAT} is needed"
        raise WeightsError(path, wrong, "Give the file that was meant")
    if any(not torch.isfinite(value.float()).all() for value in tensors.values() if value.is_floating_point()):
        raise WeightsError(path, "holds weights that are not finite", RETRAIN)
    return tensors, header
