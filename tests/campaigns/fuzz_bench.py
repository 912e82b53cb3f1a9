"""Folders of the bench that are gone on with, a file of them changed, of another program, or gone."""

import io
import json
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.campaigns.fuzz_bases import BENCH, OFFLINE, Bases
from tests.campaigns.fuzz_case import Case
from tests.campaigns.fuzz_changes import ODD, changed
from tests.campaigns.fuzz_files import change_hdf5, change_report, change_table
from tests.campaigns.fuzz_inputs import needed
from tests.campaigns.fuzz_weights import change_graph, change_tensors

INSIDE = {
    "hdf5": change_hdf5,
    "parquet": change_table,
    "json": change_report,
    "safetensors": change_tensors,
    "onnx": change_graph,
}


def _rows(draw: Any, content: bytes) -> bytes:
    """Rows, of which one is changed, at some depth."""
    lines = content.split(b"\n")[:-1]
    number = draw(st.integers(0, len(lines) - 1))
    entry = json.loads(lines[number])
    place, what = entry, draw(st.integers(0, 3))
    for _ in range(draw(st.sampled_from([0, 1, 1, 2, 3, 3]))):
        inner = [value for value in place.values() if isinstance(value, dict) and value]
        if not inner:
            break
        place = draw(st.sampled_from(inner))
    name = draw(st.sampled_from(sorted(place)))
    if what == 0:
        del place[name]
    elif what == 1 and isinstance(place[name], list):
        place[name] = draw(
            st.sampled_from([[], [[]], [[0]], [[0, None]], [["x", 1.0]], [[5, 1.0]], [[0, float("nan")]]])
        )
    else:
        place[name] = draw(st.sampled_from(ODD))
    lines[number] = json.dumps(entry).encode()
    return b"\n".join(lines) + b"\n"


def _tape(draw: Any, content: bytes) -> bytes:
    """A tape with an array changed."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    name, what = draw(st.sampled_from(sorted(arrays))), draw(st.integers(0, 6))
    value = arrays[name]
    if what == 0:
        del arrays[name]
    elif what == 1:
        arrays[name] = value[: draw(st.integers(0, len(value) - 1))]
    elif what == 2:
        value.flat[draw(st.integers(0, value.size - 1))] = draw(st.sampled_from([np.nan, np.inf, 1e30]))
    elif what == 3:
        arrays = {n: a[: draw(st.sampled_from([0, 1]))] for n, a in arrays.items()}
    elif what == 4:
        arrays[name] = value.astype(draw(st.sampled_from(["U8", "complex", "bool"])))
    elif what == 5:
        arrays[name] = np.array([{"a": 1}], object)
    else:
        arrays[name] = draw(st.sampled_from([value[..., None], value[..., :-1], value[0]]))
    held = io.BytesIO()
    np.savez(held, **arrays)
    return held.getvalue()


def benches(bases: Bases) -> st.SearchStrategy[Case]:
    """The whole folder but for one file; the same is asked for, or a detector more, which is fitted to the tapes."""
    # Of the explorer's files the bench reads none.
    own = {f"out/{name}": content for name, content in bases.bench.items()}
    names = sorted(name for name in own if name.rsplit(".")[-1] in {*INSIDE, "jsonl", "npz"})
    rows, tapes = [n for n in names if n.endswith("jsonl")], [n for n in names if n.endswith("npz")]
    others = (bases.sweep["rows.jsonl"], bases.candidate, bases.record)

    @st.composite
    def cases(draw: Any) -> Case:
        name = draw(st.sampled_from([*rows * 6, *tapes * 2, *names]))
        files = needed(bases, ("weights",)) | own
        inside = _rows if name in rows else _tape if name in tapes else INSIDE[name.rsplit(".")[-1]]
        if draw(st.integers(0, 19)) == 0:
            del files[name]
        else:
            files[name] = draw(changed(files[name], inside, others))
        more = ["--detectors", "knn", "speed"] if name in tapes or draw(st.booleans()) else []
        return Case("benches", "bench", [*BENCH, "--out", "out", *more], files, (name.split("/")[-1], "out "))

    return cases()


def exports(bases: Bases) -> st.SearchStrategy[Case]:
    """A bench of which a replay or data sets are made, and data sets that are gone on with, a file of them changed."""
    read = [
        "bench/summary.json",
        "bench/bench.parquet",
        "bench/networks/lstm.onnx",
        "bench/explorer/off-lstm-0-A-2000000.js",
    ]
    written = sorted(name for name in bases.export if name.rsplit(".")[-1] in INSIDE)
    base = ["export", "--bench", "bench", "--out", "out", "--workers", "0"]
    replay = ["--replay", "off-lstm-0-A-2000000", "--out", "bench"]

    @st.composite
    def cases(draw: Any) -> Case:
        name = draw(st.sampled_from([*read * 2, *written]))
        files = needed(bases, ("bench",)) | bases.export
        if draw(st.integers(0, 19)) == 0:
            del files[name]
        else:
            inside = INSIDE.get(name.rsplit(".")[-1], lambda draw, content: content[::-1])
            files[name] = draw(changed(files[name], inside, (bases.candidate, bases.record)))
        argv = draw(st.sampled_from([base, [*base, "--check", "1"], [*base, "--limit", "1"]]))
        argv = replay if name in read and draw(st.booleans()) else argv
        return Case("exports", "bench", argv, files, (name.split("/")[-1], "out", "bench "))

    return cases()


def runs(bases: Bases) -> st.SearchStrategy[Case]:
    """Runs of another arm, in both layouts, with a file changed."""
    names = [name for name in bases.runs if name.rsplit(".")[-1] in INSIDE]
    often = [name for name in names if name.endswith(("hdf5", "info.json")) or "/meta/" in name] * 4

    @st.composite
    def cases(draw: Any) -> Case:
        name = draw(st.sampled_from([*often, *names]))
        files, folder = needed(bases, ("runs",)), name.split("/")[0]
        files[name] = draw(changed(files[name], INSIDE[name.rsplit(".")[-1]], (bases.candidate, bases.record)))
        given = ["offline", "--data", folder, *OFFLINE]
        return Case("runs", "bench", given, files, (folder, "--period", "--state"))

    return cases()
