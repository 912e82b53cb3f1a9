"""The episodes of a sweep on disk: a Parquet part an episode, so that nothing that is finished is ever lost."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from diagrams.episodes.episode import Outcome
from models.errors import InputError

_TYPES = {
    "int": pa.int64(),
    "float": pa.float64(),
    "bool": pa.bool_(),
    "str": pa.string(),
    "tuple[float, float]": pa.list_(pa.float64()),
}
# Beside the fields of an Outcome; error_peak_*: the detector's largest error before the onset, and from there to the end of the
# disturbance + 5 ticks.
_OWN = {
    "training_seed": pa.int64(),
    "gamma": pa.float64(),
    "encoder_hash": pa.string(),
    "detector_hash": pa.string(),
    "error_peak_normal": pa.float64(),
    "error_peak_disturbed": pa.float64(),
    "error": pa.string(),
}
SCHEMA = pa.schema(
    {field.name: _TYPES[str(field.type).removesuffix(" | None")] for field in dataclasses.fields(Outcome)} | _OWN
)
# What differs from run to run; all other columns are the same for the same weights and seeds.
TIMES = ("wall_seconds", "realtime_factor")


class EpisodeStore:
    """Rows of a sweep under `folder`/parts, one file each, named by the key of its task."""

    def __init__(self, folder: Path):
        """Raises InputError if `folder` cannot be written."""
        self.folder, self._parts = folder, folder / "parts"
        try:
            self._parts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder} cannot be written ({error.strerror}): choose another --out") from error

    def add(self, key: str, row: dict[str, Any]) -> None:
        """The row is on disk when this returns; a kill in the middle leaves no part at all."""
        partial = self._parts / f"{key}.partial"
        with open(partial, "wb") as file:
            pq.write_table(_table([row]), file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, self._parts / f"{key}.parquet")

    def keep_record(self, key: str, content: bytes) -> None:
        """Writes a record (content of a file of diagrams/episodes/record.py) as `folder`/records/KEY.npz."""
        folder = self.folder / "records"
        folder.mkdir(exist_ok=True)
        (folder / f"{key}.npz").write_bytes(content)

    def read(self, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
        """The rows there are, by key."""
        rows = {}
        for key in keys:
            path = self._parts / f"{key}.parquet"
            if path.is_file():
                try:
                    rows[key] = pq.ParquetFile(path).read().to_pylist()[0]
                except (pa.ArrowInvalid, OSError, IndexError) as error:
                    raise InputError(f"{path} is damaged ({error}): delete it, and its episode is run again") from error
        return rows

    def finish(self, rows: list[dict[str, Any]]) -> Path:
        """Writes all `rows`, in their order, as `folder`/episodes.parquet; returns its name."""
        path = self.folder / "episodes.parquet"
        partial = path.with_suffix(".partial")
        pq.write_table(_table(rows), partial)
        os.replace(partial, path)
        return path


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=SCHEMA)
