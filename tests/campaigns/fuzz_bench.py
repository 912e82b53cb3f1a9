"""Folders of the bench that are gone on with, a file of them changed, of another program, or gone."""

import io
import json
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.campaigns.forked import Case
from tests.campaigns.fuzz_bases import BENCH, Bases
from tests.campaigns.fuzz_changes import ODD, changed
from tests.campaigns.fuzz_files import change_report, change_table
from tests.campaigns.fuzz_inputs import needed
from tests.campaigns.fuzz_weights import change_graph, change_tensors

INSIDE = {"parquet": change_table, "json": change_report, "safetensors": change_tensors, "onnx": change_graph}


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
    names = sorted(name for name in bases.bench if name.rsplit(".")[-1] in {*INSIDE, "jsonl", "npz"})
    rows, tapes = [n for n in names if n.endswith("jsonl")], [n for n in names if n.endswith("npz")]
    others = (bases.sweep["rows.jsonl"], bases.candidate, bases.record)

    @st.composite
    def cases(draw: Any) -> Case:
        name = draw(st.sampled_from([*rows * 6, *tapes * 2, *names]))
        files = needed(bases, ("weights",)) | dict(bases.bench)
        inside = _rows if name in rows else _tape if name in tapes else INSIDE[name.rsplit(".")[-1]]
        if draw(st.integers(0, 19)) == 0:
            del files[name]
        else:
            files[name] = draw(changed(files[name], inside, others))
        more = ["--detectors", "knn", "speed"] if name in tapes or draw(st.booleans()) else []
        return Case("benches", "bench", [*BENCH, "--out", "out", *more], files, (name.split("/")[-1], "out "))

    return cases()
