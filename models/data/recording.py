"""Writes demonstrations, and other runs, to one HDF5 file in robomimic's layout, which demonstrations.py reads."""

import hashlib
import io
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from models.checks import require_plain
from models.data.demonstrations import SPLITS, Demonstration, hdf5_errors, number_of, require_whole
from models.errors import InputError
from models.files.container import naming, write_bytes

LAYOUT_VERSION = 2
MARGIN = 1 << 20  # bytes
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

    @property
    def attributes(self) -> dict[str, Any]:
        """What a file says of the whole, beside its arrays."""
        names = ("can_xy", "vacant", "grid_index", "subtask_starts", "split", "success")
        return {name: getattr(self, name) for name in names}

    @property
    def further(self) -> dict[str, np.ndarray]:
        """Arrays beside pictures, postures and actions: none."""
        return {}


@dataclass(frozen=True)
class RecordedRun:
    """Another run, for the same files; its name is demo_ and a number.

    Attributes:
        split: "train" or "valid".
        vacant: "left" or "right".
        success: the task was done.
        rgb, posture, actions: as of a Recording.
        further: arrays (T, n) by name.
        notes: what a file says of the whole besides; plain types, by name.
    """

    name: str
    split: str
    vacant: str
    success: bool
    rgb: np.ndarray
    posture: np.ndarray
    actions: np.ndarray
    further: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attributes(self) -> dict[str, Any]:
        """As of a Recording."""
        return {"split": self.split, "success": self.success, "vacant": self.vacant, **self.notes}


def arrays_of(recording: Recording | RecordedRun) -> dict[str, np.ndarray]:
    """Its arrays, by their names in the file."""
    own = {key: getattr(recording, name) for key, name in _ARRAYS.items()}
    return own | {f"obs/{name}": array for name, array in recording.further.items()}


def digest_of(recording: Recording | RecordedRun) -> str:
    """SHA-256 (hexadecimal) of all its numbers and attributes."""
    digest = hashlib.sha256()
    for key, array in arrays_of(recording).items():
        digest.update(f"{key} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    notes = {name: np.asarray(value).tolist() for name, value in recording.attributes.items()}
    return hashlib.sha256(digest.digest() + json.dumps(notes, sort_keys=True).encode()).hexdigest()


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
            if not path.exists():
                begun = io.BytesIO()
                with h5py.File(begun, "w") as file:
                    file.create_group("data").attrs["env_args"] = text
                write_bytes(path, begun.getvalue())
            with h5py.File(path, "r") as file:  # first without touching it: it may be anybody's
                require_whole(path, file)
                _require_same(path, file, json.loads(text))
            self._path, self._file = path, h5py.File(path, "r+")
            self._reserve(0)
        self._data = self._file["data"]
        self._data.attrs.update(attributes)

    def __exit__(self, kind: object = None, error: BaseException | None = None, trace: object = None) -> None:
        number = len(self._data)
        self._file.close()
        if isinstance(error, KeyboardInterrupt | OSError):
            error.add_note(f"{self._path} keeps {number} demonstrations: the same command goes on")

    def _reserve(self, size: int) -> None:
        """Raises OSError unless there is room for `size` bytes more, and what HDF5 writes beside them.

        HDF5 itself crashes where it cannot write: another file, without a name, is made to grow so far.
        """
        with naming(self._path), tempfile.TemporaryFile(dir=self._path.parent) as file:
            os.posix_fallocate(file.fileno(), self._file.id.get_filesize(), size + MARGIN)

    def __contains__(self, name: str) -> bool:
        return name in self._data

    def add(self, recording: Recording | RecordedRun) -> None:
        """Writes one demonstration; it is whole in the file when this returns. An OSError leaves the file whole."""
        arrays = arrays_of(recording)
        self._reserve(sum(array.nbytes for array in arrays.values()))
        partial = f"partial_{recording.name}"
        if partial in self._file:  # left by a kill in the middle of a write
            del self._file[partial]
        group = self._file.create_group(partial)
        for key, array in arrays.items():
            chunks = min(32, len(array)), *array.shape[1:]
            group.create_dataset(key, data=array, compression="gzip", compression_opts=1, chunks=chunks)
        group.attrs["num_samples"] = len(recording.actions)
        group.attrs.update(recording.attributes)
        self._file.move(partial, f"data/{recording.name}")
        self._file.flush()

    def finish(self, names: Sequence[str]) -> tuple[str, list[str]]:
        """Lists those demonstrations in the mask; returns the content hash, and the names of those that failed.

        Raises DatasetError where a demonstration in the file is damaged, or the disk is full.
        """
        with hdf5_errors(self._path, "written", "choose another --out", "delete it, and record it again"):
            return self._finish(names)

    def _finish(self, names: Sequence[str]) -> tuple[str, list[str]]:
        data = self._data
        self._reserve(0)
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
        for key in dict.fromkeys((*_ARRAYS, *(f"obs/{name}" for name in sorted(demonstration["obs"])))):
            digest.update(np.ascontiguousarray(demonstration[key][()]).tobytes())
        attributes = {k: np.asarray(v).tolist() for k, v in sorted(demonstration.attrs.items())}
        digest.update(json.dumps(attributes).encode())
    return digest.hexdigest()


def _require_same(path: Path, file: h5py.File, settings: dict[str, Any]) -> None:
    try:
        found = json.loads(file["data"].attrs["env_args"])
        others = [name for name, value in settings.items() if found[name] != value]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no recording of this program: choose another --out") from error
    if others:
        words = " and another ".join(others)
        raise InputError(f"{path} was recorded with another {words}: delete it, or choose another --out")
