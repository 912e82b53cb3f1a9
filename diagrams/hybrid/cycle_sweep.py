"""What `cycle` reads of a sweep: what it was made with, how its episodes were drawn, their rows."""

import json
from pathlib import Path
from typing import Any

from diagrams.episodes.store import FIRST
from models.checks import require_plain
from models.errors import InputError

EPISODES, ROWS, SUMMARY = "episodes.parquet", "rows.jsonl", "summary.json"  # in its folder
DRAWN = {"purpose": "evaluation", "way_home": "any"}  # validation has chosen thresholds; a way home may be chosen too
LARGEST = 100_000_000  # bytes


def fingerprint(folder: Path) -> dict[str, Any]:
    """What its rows were made with; raises InputError where there is none."""
    path = folder / ROWS
    try:
        require_plain(path)
        with path.open("rb") as file:
            line = file.readline(LARGEST)
        if not line.startswith(FIRST):
            raise ValueError("no fingerprint")
        return dict(json.loads(line)["fingerprint"])
    except (OSError, RecursionError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no sweep's: give the folder of a finished one with --sweep") from error


def require_drawn(folder: Path) -> None:
    """Raises InputError for a sweep of validation episodes, or of chosen ways home."""
    path = folder / SUMMARY
    try:
        require_plain(path, largest=LARGEST)
        given = dict(json.loads(path.read_text())["arguments"])
    except (OSError, RecursionError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no sweep's: give the folder of a finished one with --sweep") from error
    for name, wanted in DRAWN.items():
        if (found := given.get(name)) != wanted:
            option = name.replace("_", "-")
            raise InputError(f"{path} is of --{option} {found!s:.60}: give a sweep of --{option} {wanted}")


def episodes(folder: Path) -> list[dict[str, Any]]:
    """Its rows, None where a value is missing; raises InputError where they cannot be read."""
    from models.command_line import require

    require("pandas", "pyarrow", "scipy")
    import pandas as pd

    path = folder / EPISODES
    if not path.is_file():
        raise InputError(f"there is no {path}: give the folder of a finished sweep with --sweep")
    try:
        frame = pd.read_parquet(path)
    except Exception as error:  # pyarrow has a dozen, of strange bytes
        raise InputError(f"{path} cannot be read: run the sweep's command again, it makes it anew") from error
    return [
        {str(name): None if pd.isna(value) else value for name, value in row.items() if pd.api.types.is_scalar(value)}
        for row in frame.to_dict("records")
    ]
