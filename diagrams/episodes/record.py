"""Records on disk: what `pick_place.py --log FILE.npz` leaves behind, and what the analysis reads."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import zipfile
import zlib
from pathlib import Path

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.rollout import Record
from models.errors import InputError

_ARRAYS = tuple(f.name for f in dataclasses.fields(Record) if f.name != "events")


def digest(record: Record) -> str:
    """SHA-256 (hexadecimal) over every number of `record`: equal for two runs that agree bit by bit, and hardly for others."""
    total = hashlib.sha256()
    for name in _ARRAYS:
        array = np.ascontiguousarray(getattr(record, name))
        total.update(f"{name} {array.dtype} {array.shape}".encode())
        total.update(array.tobytes())
    return total.hexdigest()


def save_record(path: Path, record: Record, outcome: Outcome) -> None:
    """Writes `record` and `outcome` to `path` (.npz)."""
    text = json.dumps({"events": record.events, "outcome": outcome.to_dict()})
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.stem}.{os.getpid()}.part")
    with partial.open("wb") as file:  # by name numpy would add .npz
        np.savez_compressed(file, text=np.array(text), **{n: getattr(record, n) for n in _ARRAYS})
    partial.replace(path)


def load_record(path: Path) -> tuple[Record, dict]:
    """The record in `path` and its outcome as a dictionary (see Outcome); raises InputError for a file that holds none."""
    if not path.is_file():
        raise InputError(f"there is no record {path}: write one with `pick_place.py --log FILE.npz`")
    try:
        with np.load(path, allow_pickle=False) as file:
            text = json.loads(str(file["text"]))
            arrays = {name: file[name] for name in _ARRAYS}
        return Record(**arrays, events=[(float(t), str(what)) for t, what in text["events"]]), text["outcome"]
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        OSError,
        EOFError,
        zlib.error,
        zipfile.BadZipFile,
    ) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} holds no record ({reason}): write one with `pick_place.py --log FILE.npz`") from error


def find_records(paths: list[Path]) -> list[Path]:
    """The record files among `paths`, folders replaced by the .npz files in them; raises InputError for an empty folder."""
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.npz")) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"there is no record (.npz) in the folder {path}: write one with `pick_place.py --log`")
        found += inside
    return found
