"""The bench's explorer: one HTML file that needs no server; an episode's trace is a script beside it."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from models.files.container import write_text

PAGE = "explorer.html"
WORDS = ("detector", "fault", "severity", "recovery", "network", "label", "off")  # few values, on many rows
NUMBERS = ("seed", "needed", "success", "acts", "onset_s", "alarm_s", "false_alarms", "length_s", "lost_s")
DIGITS = 6  # of what is shown
Entry = Mapping[str, Any]


def write_explorer(
    folder: Path, cells: Sequence[Entry], episodes: Sequence[Entry], gammas: Entry, beta: float, period: float
) -> Path:
    """Writes the page into `folder`; returns its name.

    Args:
        cells: each with what it is of, and numbers, or numbers with an interval.
        episodes: each with WORDS and NUMBERS. `off` is the key of the run with the detector off; where `acts` there is
            one in the loop too: traces and pictures are in the folder `explorer` under these keys.
        gammas: by network and detector.
        beta: of all detectors; period: of the ticks, s.
    """
    columns: dict[str, Any] = {name: _coded([row[name] for row in episodes]) for name in WORDS}
    columns |= {name: [row[name] for row in episodes] for name in NUMBERS}
    data = {
        "cells": cells, "count": len(episodes), "episodes": columns, "gammas": gammas, "beta": beta, "period": period,
    }  # fmt: skip
    page, path = Path(__file__).with_suffix(".html").read_text(), folder / PAGE
    # Nothing in the data can end the element that it stands in.
    text = json.dumps(_rounded(data), separators=(",", ":")).replace("<", "\\u003c")
    write_text(path, page.replace("@DATA@", text, 1))
    return path


def write_replays(folder: Path) -> None:
    """Tells the page which 3-D replays there are: each .html in its `folder` of episodes."""
    found = sorted(path.name.removesuffix(".html") for path in folder.glob("*.html"))
    write_text(folder / "replays.js", f"const REPLAYS = {json.dumps(found)};\n")


def _coded(values: list[Any]) -> dict[str, list]:
    """The values there are, and for each of `values` its place among these."""
    there = list(dict.fromkeys(values))
    places = {value: place for place, value in enumerate(there)}
    return {"values": there, "at": [places[value] for value in values]}


def _rounded(value: Any) -> Any:
    """Floats in it, at any depth, to DIGITS; None for those that are no finite numbers, which JSON has not."""
    if isinstance(value, Mapping):
        return {name: _rounded(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value
