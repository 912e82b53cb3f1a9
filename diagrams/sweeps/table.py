"""The table of a sweep, a row an episode: written when all rows are there, read together with those of other sweeps."""

from pathlib import Path
from typing import Any, get_args, get_type_hints

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from diagrams.episodes.episode import Outcome
from diagrams.sweeps.task import ROBUSTNESS
from diagrams.world.configuration import World
from diagrams.world.requirements import requirements
from models.errors import InputError
from models.files.container import whole_file

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
    "own_code": pa.string(),
    "error_peak_normal": pa.float64(),
    "error_peak_disturbed": pa.float64(),
    "error": pa.string(),
    "traceback": pa.string(),  # of the error
}
# Of a type such as float | None the first is what the column holds.
_OUTCOME = {name: _TYPES.get(kind) or _TYPES[get_args(kind)[0]] for name, kind in get_type_hints(Outcome).items()}
_ROBUSTNESS = {ROBUSTNESS + name: pa.float64() for name in requirements(World().timing.period)}
SCHEMA = pa.schema(_OUTCOME | _OWN | _ROBUSTNESS)
_EPISODE = ("rnn", "training_seed", "detector", "gamma", "disturbance", "severity", "seed")
_KNOWN = (*_EPISODE, "weights_hash", "success", "void", "error")
# Columns that tables of earlier versions lack: they are empty.
LATER = ("traceback", "severity", "own_code", "recovery", *_ROBUSTNESS)


def require_rows(path: Path, rows: dict[str, Any]) -> None:
    """Raises InputError unless the `rows` of the file `path`, by key, make a table: all columns, of their types.

    Of an episode that raised an error only what was known before it was run.
    """
    for key, row in rows.items():
        try:
            # Rows of earlier versions have neither, and may be gone on with.
            absent = set(SCHEMA.names if row["error"] is None else _KNOWN) - row.keys() - {"own_code", "recovery"}
            if absent:
                raise ValueError(f"no {', '.join(sorted(absent))}")
            pa.Table.from_pylist([row], schema=SCHEMA)
        except Exception as error:  # pyarrow has a class of its own for each type
            words = " ".join(str(error).split())[:200]
            raise InputError(f"{path} has a row that is none, {key} ({words}): choose another --out") from error


def write_table(folder: Path, rows: list[dict[str, Any]]) -> Path:
    """Writes all `rows`, in their order, as the table in `folder`; returns its name."""
    path = folder / TABLE
    with whole_file(path) as partial:
        pq.write_table(pa.Table.from_pylist(rows, schema=SCHEMA), partial)
    return path


def _alike(found: pa.DataType, wanted: pa.DataType) -> bool:
    """Whether a column of one type can stand for the other: pandas makes floats of whole numbers with gaps."""
    for kinds in ((pa.types.is_integer, pa.types.is_floating), (pa.types.is_string, pa.types.is_large_string)):
        if any(is_kind(wanted) for is_kind in kinds):
            return any(is_kind(found) for is_kind in kinds)
    return found == wanted


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
        except Exception as error:  # of strange bytes pyarrow and pandas raise a dozen types
            words = " ".join(str(error).split())[:200]
            raise InputError(f"{path} is damaged ({words}): delete it, and run the sweep again") from error
        missing = [name for name in SCHEMA.names if name not in table.columns and name not in LATER]
        if missing:
            raise InputError(
                f"{path} has no column {', '.join(missing)}, another version of sweep.py wrote it: "
                "run the sweep again, with another --out"
            )
        try:
            whole = pa.Table.from_pandas(table[[n for n in SCHEMA.names if n in table.columns]], preserve_index=False)
            names = [name for name in whole.column_names if not pa.types.is_null(whole.schema.field(name).type)]
            other = [name for name in names if not _alike(whole.schema.field(name).type, SCHEMA.field(name).type)]
            table = table.reindex(columns=list(dict.fromkeys([*table.columns, *LATER]))).astype(object)
        except Exception as error:
            raise InputError(f"{path} is damaged ({error}): delete it, and run the sweep again") from error
        if other:
            raise InputError(
                f"{path} has another type in the column {', '.join(other)}, another version of sweep.py wrote it: run "
                "the sweep again, with another --out"
            )
        tables.append(table)
    rows = pd.concat(tables, ignore_index=True).infer_objects()
    if rows.duplicated(_EPISODE).any():
        raise InputError(
            f"some episodes are in several of {', '.join(map(str, folders))}: they would count twice, give one"
        )
    return rows
