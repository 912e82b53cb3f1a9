"""Writes the teacher's demonstrations to one HDF5 file in robomimic's layout, which demonstrations.py reads."""

import hashlib
import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from models.checks import require_plain
from models.data.demonstrations import SPLITS, Demonstration, hdf5_errors, number_of
from models.errors import InputError

LAYOUT_VERSION = 2
_ARRAYS = {"obs/rgb": "rgb", "obs/posture": "posture", "actions": "actions"}  # name in the file: field of Recording


@dataclass(frozen=True)
class Recording(Demonstration):
    """A demonstration as the teacher gives it; its name is demo_ and a number.

    Attributes:
        rgb: (T, height, width, 3) uint8, what the camera saw.
        grid_index: of the can.
        success: the task was done.
    """

    rgb: np.ndarray
    grid_index: tuple[int, int]
    success: bool


class RecordingFile(AbstractContextManager):
    """An HDF5 file to which demonstrations are added; a context manager. An unfinished one is completed.

    A kill leaves either all of a demonstration or, under another name, a part of it that is written again.
    """

    def __init__(self, path: Path, settings: dict[str, Any], attributes: dict[str, Any]):
        """Opens or begins the file.

        `settings`: plain types that decide the content; `attributes`: of the whole file. Raises InputError where it
        cannot be written, is in use or damaged, or is no recording with these settings: it is left untouched.
        """
        text = json.dumps(settings | {"layout": LAYOUT_VERSION}, sort_keys=True)
        damaged = "if a kill in the middle of a write broke it, delete it"
        with hdf5_errors(path, "written", "choose another --out", damaged):
            if not path.is_dir():
                require_plain(path, "choose another --out")
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():  # begun under another name: a kill leaves no half of a file
                begun = path.with_name(f"{path.name}.part")
                with h5py.File(begun, "w") as file:
                    file.create_group("data").attrs["env_args"] = text
                begun.replace(path)
            with h5py.File(path, "r") as file:  # first without touching it: it may be anybody's
                _require_same(path, file, json.loads(text))
            self._file = h5py.File(path, "r+")
        self._data = self._file["data"]
        self._data.attrs.update(attributes)

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def __contains__(self, name: str) -> bool:
        return name in self._data

    def add(self, recording: Recording) -> None:
        """Writes one demonstration; it is whole in the file when this returns."""
        partial = f"partial_{recording.name}"
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
        self._file.move(partial, f"data/{recording.name}")
        self._file.flush()

    def finish(self, names: Sequence[str]) -> tuple[str, list[str]]:
        """Lists those demonstrations in the mask; returns the content hash, and the names of those that failed.

        Raises DatasetError where a demonstration in the file is damaged, or the disk is full.
        """
        with self._errors():
            return self._finish(names)

    def _errors(self) -> AbstractContextManager[None]:
        return hdf5_errors(self._file.filename, "written", "choose another --out", "delete it, and record it again")

    def _finish(self, names: Sequence[str]) -> tuple[str, list[str]]:
        data = self._data
        if "mask" in self._file:
            del self._file["mask"]
        for split in SPLITS:
            self._file[f"mask/{split}"] = np.array([n.encode() for n in names if data[n].attrs["split"] == split])
        data.attrs["total"] = int(sum(data[n].attrs["num_samples"] for n in names))
        data.attrs["content_hash"] = content_hash(self._file)
        return data.attrs["content_hash"], [name for name in names if not data[name].attrs["success"]]


def content_hash(file: h5py.File) -> str:
    """SHA-256 of the demonstrations in the mask, arrays and attributes, by number: not of the order of writing."""
    digest = hashlib.sha256()
    listed = [name.decode() for split in SPLITS for name in file[f"mask/{split}"][()]]
    for name in sorted(listed, key=number_of):
        demonstration = file["data"][name]
        digest.update(name.encode())
        for key in _ARRAYS:
            digest.update(np.ascontiguousarray(demonstration[key][()]).tobytes())
        attributes = {k: np.asarray(v).tolist() for k, v in sorted(demonstration.attrs.items())}
        digest.update(json.dumps(attributes).encode())
    return digest.hexdigest()


def _require_same(path: Path, file: h5py.File, settings: dict[str, Any]) -> None:
    try:
        found = json.loads(file["data"].attrs["env_args"])
        others = [name for name, value in settings.items() if found[name] != value]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no recording of diagrams/teach.py: choose another --out") from error
    if others:
        words = " and another ".join(others)
        raise InputError(f"{path} was recorded with another {words}: delete it, or choose another --out")
