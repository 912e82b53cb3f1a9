"""Writes the teacher's demonstrations to one HDF5 file in robomimic's layout, which demonstrations.py reads."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from models.errors import InputError

LAYOUT_VERSION = 2
SPLITS = ("train", "valid")
_ARRAYS = {"obs/rgb": "rgb", "obs/posture": "posture", "actions": "actions"}  # name in the file: field of Recording


@dataclass(frozen=True)
class Recording:
    """One demonstration as it is written; T ticks."""

    index: int
    rgb: np.ndarray  # (T, height, width, 3) uint8
    posture: np.ndarray  # (T, 8) measured joints (rad) and commanded opening (m)
    actions: np.ndarray  # (T, 8) commanded next posture
    can_xy: np.ndarray  # (2,) m, world
    vacant: str  # left or right
    grid_index: tuple[int, int]  # of the can
    subtask_starts: tuple[int, ...]  # first tick of each subtask
    split: str  # of SPLITS
    success: bool


class RecordingFile:
    """An HDF5 file to which demonstrations are added; a context manager. An unfinished one is completed.

    A kill leaves either all of a demonstration or, under another name, a part of it that is written again.
    """

    def __init__(self, path: Path, settings: dict[str, Any], attributes: dict[str, Any]):
        """Opens or begins the file.

        Args:
            settings: plain types that decide the content; a file with others is refused, untouched.
            attributes: of the whole file.

        Raises InputError where it cannot be written, is in use, damaged, or not a recording with these settings.
        """
        self._settings = settings | {"layout": LAYOUT_VERSION}
        text = json.dumps(self._settings, sort_keys=True)
        if path.exists():
            with _open(path, "r") as file:  # first without touching it: it may be anybody's
                self._require_same(path, file)
        else:
            # Begun under another name, so that a kill leaves no half of a file.
            begun = path.with_name(f"{path.name}.part")
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                with h5py.File(begun, "w") as file:
                    file.create_group("data").attrs["env_args"] = text
                begun.replace(path)
            except OSError as error:
                reason = os.strerror(error.errno) if error.errno else str(error)
                raise InputError(f"{path} cannot be written ({reason}): choose another --out") from error
        self._file = _open(path, "r+")
        self._data = self._file["data"]
        self._data.attrs.update(attributes)
        self._file.flush()

    def __enter__(self) -> RecordingFile:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def __contains__(self, index: int) -> bool:
        return f"demo_{index}" in self._data

    def add(self, recording: Recording) -> None:
        """Writes one demonstration; it is whole in the file when this returns."""
        partial = f"partial_{recording.index}"
        if partial in self._file:  # left by a kill in the middle of a write
            del self._file[partial]
        group = self._file.create_group(partial)
        for key, name in _ARRAYS.items():
            array = getattr(recording, name)
            chunks = min(32, len(array)), *array.shape[1:]
            group.create_dataset(key, data=array, compression="gzip", compression_opts=1, chunks=chunks)
        group.attrs["num_samples"] = len(recording.actions)
        for name in ("can_xy", "vacant", "grid_index", "subtask_starts", "split", "success"):
            group.attrs[name] = getattr(recording, name)
        self._file.move(partial, f"data/demo_{recording.index}")
        self._file.flush()

    def finish(self, indices: Sequence[int]) -> list[str]:
        """Lists those demonstrations in the mask, with their total and content hash; returns the names of those that failed."""
        names, data = [f"demo_{index}" for index in indices], self._data
        if "mask" in self._file:
            del self._file["mask"]
        for split in SPLITS:
            self._file[f"mask/{split}"] = np.array([n.encode() for n in names if data[n].attrs["split"] == split])
        data.attrs["total"] = int(sum(data[n].attrs["num_samples"] for n in names))
        data.attrs["content_hash"] = content_hash(self._file)
        self._file.flush()
        return [name for name in names if not data[name].attrs["success"]]

    @property
    def content_hash(self) -> str:
        """Of the finished file."""
        return str(self._data.attrs["content_hash"])

    def _require_same(self, path: Path, file: h5py.File) -> None:
        try:
            found = json.loads(file["data"].attrs["env_args"])
            others = [name for name, value in self._settings.items() if found[name] != json.loads(json.dumps(value))]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path} is no recording of diagrams/teach.py: choose another --out") from error
        if others:
            raise InputError(
                f"{path} was recorded with another {' and another '.join(others)}: delete it, or choose another --out"
            )


def content_hash(file: h5py.File) -> str:
    """SHA-256 over arrays and attributes of the demonstrations in the mask, in the order of their numbers: equal for equal
    content, however it was written."""
    digest = hashlib.sha256()
    listed = [name.decode() for split in SPLITS for name in file[f"mask/{split}"][()]]
    for name in sorted(listed, key=lambda n: int(n.split("_")[1])):
        demonstration = file["data"][name]
        digest.update(name.encode())
        for key in _ARRAYS:
            digest.update(np.ascontiguousarray(demonstration[key][()]).tobytes())
        attributes = {k: np.asarray(v).tolist() for k, v in sorted(demonstration.attrs.items())}
        digest.update(json.dumps(attributes).encode())
    return digest.hexdigest()


def _open(path: Path, mode: str) -> h5py.File:
    try:
        return h5py.File(path, mode)
    except OSError as error:
        if isinstance(error, BlockingIOError) or "already open" in str(error):
            raise InputError(
                f"{path} is in use by another program: wait for its end, or choose another --out"
            ) from error
        if error.errno:
            raise InputError(f"{path} cannot be opened ({os.strerror(error.errno)}): choose another --out") from error
        raise InputError(
            f"{path} cannot be opened as HDF5 ({error}): if a kill in the middle of a write broke it, delete it"
        ) from error
