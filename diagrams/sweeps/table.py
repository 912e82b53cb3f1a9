"""The table of a sweep, a row an episode: written when all rows are there, read together with those of other sweeps."""

from pathlib import Path
from typing import Any, get_args, get_type_hints

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from diagrams.episodes.episode import Outcome
from models.errors import InputError

TABLE = "episodes.parquet"
_TYPES = {
    int: pa.int64(),
    float: pa.float64(),
    bool: pa.bool_(),
    str: pa.string(),
    tuple[float, float]: pa.list_(pa.float64()),
}
# Beside the fields of an Outcome; error_peak_*: the detector's largest error before the onset, and from there to the
# end of the disturbance.
_OWN = {
    "training_seed": pa.int64(),
    "gamma": pa.float64(),
    "encoder_hash": pa.string(),
    "detector_hash": pa.string(),
    "error_peak_normal": pa.float64(),
    "error_peak_disturbed": pa.float64(),
    "error": pa.string(),
    "traceback": pa.string(),  # of the error
}
# Of a type such as float | None the first is what the column holds.
_OUTCOME = {name: _TYPES.get(kind) or _TYPES[get_args(kind)[0]] for name, kind in get_type_hints(Outcome).items()}
SCHEMA = pa.schema(_OUTCOME | _OWN)
_EPISODE = ["rnn", "training_seed", "detector", "gamma", "disturbance", "severity", "seed"]
LATER = ("traceback", "severity")  # columns that tables of earlier versions may lack


def write_table(folder: Path, rows: list[dict[str, Any]]) -> Path:
    """Writes all `rows`, in their order, as the table in `folder`; returns its name."""
    path = folder / TABLE
    partial = path.with_suffix(".partial")
    pq.write_table(pa.Table.from_pylist(rows, schema=SCHEMA), partial)
    partial.replace(path)
    return path


def read_tables(folders: list[Path]) -> pd.DataFrame:
    """The episodes of the sweeps in `folders`.

    Raises InputError for a folder without a table, one that is damaged or was written by another version, and an
    episode that two of them have.
    """
    tables = []
    for folder in folders:
        path = folder / TABLE
        if not path.is_file():
            raise InputError(f"{path} does not exist: run diagrams/sweep.py with --out {folder}, to its end")
        try:
            table = pd.read_parquet(path)
        except (OSError, ValueError) as error:  # pyarrow's errors are ValueErrors
            raise InputError(f"{path} is damaged ({error}): delete it, and run the sweep again") from error
        missing = [name for name in SCHEMA.names if name not in table.columns and name not in LATER]
        if missing:
            raise InputError(
                f"{path} has no column {', '.join(missing)}, another version of sweep.py wrote it: "
                "run the sweep again, with another --out"
            )
        tables.append(table.reindex(columns=list(dict.fromkeys([*table.columns, *LATER]))).astype(object))
    rows = pd.concat(tables, ignore_index=True).infer_objects()
    if rows.duplicated(_EPISODE).any():
        raise InputError(
            f"some episodes are in several of {', '.join(map(str, folders))}: they would count twice, give one"
        )
    return rows
