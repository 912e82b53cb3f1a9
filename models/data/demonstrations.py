"""Reads the teacher's data set (HDF5, robomimic layout) and cuts it into subtask sequences."""

import errno
import hashlib
import itertools
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from models.command_line import REMEDIES
from models.errors import InputError
from models.policy import PICTURE

SPLITS = ("train", "valid")
START_TICKS, END_TICKS = 3, 14  # of a subtask's dwells that are kept
LEAST_TICKS, MOST_TICKS = 12, 100_000  # of a subtask, and of a demonstration
LARGEST_CHUNK = 100_000_000  # bytes
MOST_CHUNKS = 100_000  # of an array: HDF5 takes hundreds of bytes for each that it looks for
LARGEST = 1000.0  # rad and m, and more than any posture has
TOLERANCE = 0.02  # rad and m: a posture nearer than that to the dwell's is taken for dwelling


class DatasetError(InputError):
    """The data set is missing, damaged, or not in the expected layout."""


@dataclass(frozen=True)
class Demonstration:
    """One demonstration without its pictures.

    Attributes:
        name: group name in the file.
        split: "train" or "valid".
        can_xy: (2,) m, world frame.
        vacant: "left" or "right".
        subtask_starts: first tick of each subtask.
        posture: (T, 8) measured joints (rad) and commanded opening (m).
        actions: (T, 8) commanded next posture.
    """

    name: str
    split: str
    can_xy: np.ndarray
    vacant: str
    subtask_starts: tuple[int, ...]
    posture: np.ndarray
    actions: np.ndarray


@dataclass(frozen=True)
class DatasetHeader:
    """Attributes of the whole file.

    initial_posture (8,); world: what a network trained on it takes for granted, plain types; a hash of the content.
    """

    initial_posture: np.ndarray
    world: dict[str, Any]
    content_hash: str


@contextmanager
def hdf5_errors(path: str | Path, verb: str, remedy: str, damaged: str) -> Iterator[None]:
    """Where the HDF5 file `path` cannot be `verb` (read, written) in the block, one DatasetError says why."""
    try:
        yield
    except OSError as error:
        number = error.errno or 0
        helps = REMEDIES[number] if number == errno.EFBIG else remedy  # of which no other place is free
        wrong = f"cannot be {verb} ({os.strerror(number)}): {helps}"
        if isinstance(error, BlockingIOError) or "already open" in str(error):
            wrong = f"is in use by another program: wait for its end, or {remedy}"
        elif not error.errno:
            wrong = f"is no HDF5 ({error}): {damaged}"
        raise DatasetError(f"{path} {wrong}") from error
    except InputError:
        raise
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:  # of h5py, by what is broken
        raise DatasetError(f"{path} is damaged ({' '.join(str(error).split()):.200}): {damaged}") from error


def require_whole(path: str | Path, file: h5py.File) -> None:
    """Raises DatasetError for a part in another file: that may be gone, which HDF5 reads as zeros, or be a pipe."""

    def outside(name: bytes, link: Any) -> str | None:
        return name.decode(errors="replace") if link.type == h5py.h5l.TYPE_EXTERNAL else None

    def outside_too(name: str, found: h5py.Group | h5py.Dataset) -> str | None:
        return name if isinstance(found, h5py.Dataset) and (found.is_virtual or found.external) else None

    if name := file.id.links.visit(outside, info=True) or file.visititems(outside_too):
        raise DatasetError(f"{path}: {name} lies in another file: put it into this one")


@contextmanager
def _open(path: str | Path) -> Iterator[h5py.File]:
    """The file, for reading; raises DatasetError where that, or what is read in it, fails."""
    if not Path(path).is_file():
        raise DatasetError(f"{path}: the data set does not exist. Record it: `python diagrams/teach.py --out {path}`")
    try:
        with hdf5_errors(path, "read", "give another --data", "record it again"), h5py.File(path, "r") as file:
            require_whole(path, file)
            yield file
    except RecursionError as error:
        raise DatasetError(f"{path} is damaged ({error}): record it again") from error


def number_of(name: str) -> int:
    """The number in a demonstration's name."""
    return int(name.rsplit("_", 1)[1])


def read_header(path: str | Path) -> DatasetHeader:
    """Reads the file's attributes."""
    with _open(path) as file:
        attributes: Any = file["data"].attrs
        world = dict(json.loads(attributes.get("world", "{}")))
        initial = np.array(attributes["initial_posture"], float)
        if initial.ndim != 1 or not np.isfinite(initial).all():
            raise ValueError(f"initial_posture is {initial}")
        return DatasetHeader(initial, world, str(attributes["content_hash"]))


def read_demonstrations(path: str | Path, split: str | None = None) -> list[Demonstration]:
    """All demonstrations, or those of one split ("train", "valid"), in the order of their numbers."""
    with _open(path) as file:
        splits = {name.decode(): part for part in SPLITS for name in _small(file[f"mask/{part}"])[()]}
        size = np.size(file["data"].attrs["initial_posture"])
        found = [
            _demonstration(name, splits[name], file["data"][name], size)
            for name in sorted(splits, key=number_of)
            if split in (None, splits[name])
        ]
    _require_some(path, split, found)
    return found


def read_both_splits(path: str | Path) -> list[Demonstration]:
    """As `read_demonstrations`; raises DatasetError also where one of the splits has none."""
    found = read_demonstrations(path)
    for split in SPLITS:
        _require_some(path, split, [demo for demo in found if demo.split == split])
    return found


def _require_some(path: str | Path, split: str | None, demos: list[Demonstration]) -> None:
    if not demos:
        what = "file" if split is None else f"split {split}"
        raise DatasetError(f"{path}: the {what} has no demonstration: teach more (diagrams/teach.py, a larger --limit)")


def _small(dataset: h5py.Dataset) -> h5py.Dataset:
    """The dataset; raises ValueError where a part of it that is read at once would take more than LARGEST_CHUNK.

    Also for more than MOST_CHUNKS, whether or not they are there.
    """
    if dataset.chunks is not None and (size := int(np.prod(dataset.chunks)) * dataset.dtype.itemsize) > LARGEST_CHUNK:
        raise ValueError(f"{dataset.name} has chunks of {size} bytes, more than {LARGEST_CHUNK}")
    counts = [-(-axis // chunk) for axis, chunk in zip(dataset.shape, dataset.chunks or (), strict=False)]
    if (count := math.prod(counts)) > MOST_CHUNKS:
        raise ValueError(f"{dataset.name} has {count} chunks, more than {MOST_CHUNKS}")
    if dataset.chunks is not None and (there := dataset.id.get_num_chunks()) < count:  # the others would be zeros
        raise ValueError(f"{dataset.name} has {there} chunks of {count}")
    if dataset.ndim < 4 and (size := dataset.size * dataset.dtype.itemsize) > LARGEST_CHUNK:
        raise ValueError(f"{dataset.name} has {size} bytes, more than {LARGEST_CHUNK}")
    return dataset


def _demonstration(name: str, split: str, group: h5py.Group, size: int) -> Demonstration:
    """The demonstration in its group, of postures with `size` components; raises ValueError for what makes none."""
    shapes = {key: _small(group[key]).shape for key in ("obs/posture", "actions", "obs/rgb")}
    ticks = shapes["obs/posture"][0] if shapes["obs/posture"] else 0
    wanted = {"obs/posture": (ticks, size), "actions": (ticks, size), "obs/rgb": (ticks, *PICTURE)}
    if shapes != wanted or group["obs/rgb"].dtype != np.uint8 or ticks > MOST_TICKS:
        words = ", ".join(f"{key} {shape}" for key, shape in shapes.items())
        raise ValueError(
            f"{name} holds {words}: rows of one length, at most {MOST_TICKS}, and pictures {PICTURE} are needed"
        )
    posture, actions = (np.array(group[key], float) for key in ("obs/posture", "actions"))
    can_xy, starts = np.array(group.attrs["can_xy"], float), tuple(int(k) for k in group.attrs["subtask_starts"])
    for what, array in (("obs/posture", posture), ("actions", actions), ("can_xy", can_xy)):
        if not np.isfinite(array).all() or np.abs(array).max(initial=0.0) > LARGEST:
            raise ValueError(f"{name} has the {what} {array!s:.60}: finite numbers of at most {LARGEST:g} are needed")
    edges = (*starts, ticks)
    if can_xy.shape != (2,) or not starts or starts[0] != 0 or min(np.diff(edges)) < LEAST_TICKS:
        raise ValueError(
            f"{name} has the can_xy {can_xy} and the subtask_starts {starts} of {ticks} ticks: x and y, and subtasks "
            f"of {LEAST_TICKS} ticks or more from 0 on, are needed"
        )
    return Demonstration(name, split, can_xy, str(group.attrs["vacant"]), starts, posture, actions)


def content_of(path: str | Path) -> str:
    """SHA-256 of the teacher's content hash and of all but the pictures that the file holds.

    The teacher's hash alone stays as it was while demonstrations are added.
    """
    digest = hashlib.sha256(read_header(path).content_hash.encode())
    for demo in read_demonstrations(path):
        digest.update(f"{demo.name} {demo.split} {demo.vacant} {demo.subtask_starts}".encode())
        for array in (demo.can_xy, demo.posture, demo.actions):
            digest.update(array.tobytes())
    return digest.hexdigest()


def iterate_frames(path: str | Path, names: Sequence[str], stop: int | None = None) -> Iterator[np.ndarray]:
    """The pictures of each named demonstration in turn, uint8 (T, 112, 112, 3), or of its first `stop` ticks."""
    with _open(path) as file:
        for name in names:
            yield file["data"][name]["obs/rgb"][:stop]


def subtask_ranges(demo: Demonstration) -> list[tuple[int, int]]:
    """Tick ranges [start, stop) of the subtasks, their dwells cut to START_TICKS and END_TICKS.

    A tick dwells while every component is within TOLERANCE of the subtask's first (last) posture. A long dwell at the
    start would teach the network to wait until it sees itself move.
    """
    edges = [*demo.subtask_starts, len(demo.posture)]
    ranges = []
    for first, last in itertools.pairwise(edges):
        posture = demo.posture[first:last]
        away = np.flatnonzero(np.abs(posture - posture[0]).max(axis=1) > TOLERANCE)
        back = np.flatnonzero(np.abs(posture - posture[-1]).max(axis=1) > TOLERANCE)
        if not len(away):
            raise DatasetError(f"{demo.name}: nothing moves between ticks {first} and {last}")
        ranges.append((first + max(0, int(away[0]) - START_TICKS), min(last, first + int(back[-1]) + 1 + END_TICKS)))
    return ranges
