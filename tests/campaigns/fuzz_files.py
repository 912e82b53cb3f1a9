"""Demonstrations, records, sweeps, reports and checkpoints with their bytes or their contents changed."""

import io
import json
from typing import Any

import h5py
import numpy as np
from hypothesis import strategies as st

from tests.campaigns.fuzz_bases import CAE, RECALL, RNN, SWEEP, Bases
from tests.campaigns.fuzz_case import Case
from tests.campaigns.fuzz_changes import ODD, changed
from tests.campaigns.fuzz_inputs import needed


def change_hdf5(draw: Any, content: bytes) -> bytes:
    """Demonstrations with a group, an array or an attribute changed."""
    held = io.BytesIO(content)
    with h5py.File(held, "r+") as file:
        for _ in range(draw(st.sampled_from([1, 1, 2]))):
            names: list[str] = []
            file.visit(names.append)
            name = draw(st.sampled_from([*(n for n in names if "rgb" in n or n.startswith("mask")), *names]))
            node = file[name]
            what = draw(st.integers(0, 5))
            if what == 0 and len(node.attrs):
                key = draw(st.sampled_from(sorted(node.attrs)))
                del node.attrs[key]
            elif what <= 2 and len(node.attrs):
                key = draw(st.sampled_from(sorted(node.attrs)))
                odd = draw(st.sampled_from([0, -1, 5.5, np.nan, "x", "", "{", "[]", [0, 10**6], [30, 0], [0, 0],
                [-5, 3],
                                            [np.nan] * 8, [1.0] * 7, [np.inf] * 2, np.zeros((2, 2)),
                                            2**40]))  # fmt: skip
                node.attrs[key] = odd
            # Of an earlier turn some are single numbers, empty, or as bent == 5 leaves them.
            elif isinstance(node, h5py.Dataset) and what <= 4 and node.shape[:1] not in ((), (0,), (10**7,)):
                value = node[()]
                del file[name]
                bent = draw(st.integers(0, 8))
                if bent == 0:
                    file[name] = value[: draw(st.integers(0, len(value)))]
                elif bent == 1:
                    file[name] = np.concatenate([value, value[:3]])
                elif bent == 2 and value.dtype.kind == "f":
                    value[draw(st.integers(0, len(value) - 1))] = draw(st.sampled_from([np.nan, np.inf, 1e300, -1e5]))
                    file[name] = value
                elif bent == 3:
                    file[name] = value[:, ..., :-1] if value.ndim > 1 else value
                elif bent == 4:
                    file[name] = np.zeros(len(value), "S5")
                elif bent == 5:  # nothing of it is there
                    dtype = value.dtype if value.dtype.itemsize else "S1"  # of empty text there is no file
                    file.create_dataset(
                        name, shape=(10**7, *value.shape[1:]), dtype=dtype, chunks=(1, *value.shape[1:])
                    )
                elif bent == 6:
                    file[name] = h5py.SoftLink(f"/{name}")
                elif bent == 7:
                    file[name] = h5py.ExternalLink("note.txt", "/data")
                else:
                    file[name] = np.zeros((), value.dtype)
            else:
                del file[name]
    return held.getvalue()


def demonstrations(bases: Bases) -> st.SearchStrategy[Case]:
    """Data sets, for what learns from them, and for teach.py that would go on with them."""
    cae = ["cae", "--data", "demos.h5", "--out", "out", "--batch-size", "2", "--max-images", "2"]
    readers = (
        ("training", cae, ()), ("training", RNN, ("weights",)), ("training", RECALL, ("weights", "candidate")),
        ("training", ["probe", "--data", "demos.h5", "--encoder", "weights/encoder.onnx"], ("weights",)),
        ("baselines", ["--policies", "weights/lstm.onnx", "--data", "demos.h5", "--encoder", "weights/encoder.onnx"],
         ("policies",)),
        ("teach", ["--out", "demos.h5", "--limit", "1"], ()),
    )  # fmt: skip

    @st.composite
    def cases(draw: Any) -> Case:
        program, argv, needs = draw(st.sampled_from(readers))
        files = needed(bases, needs)
        files["demos.h5"] = draw(changed(bases.demos, change_hdf5, (bases.record, bases.candidate)))
        return Case("demonstrations", program, argv, files, ("demos.h5", "demo_"))

    return cases()


def _npz(draw: Any, content: bytes) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    name = draw(st.sampled_from(sorted(arrays)))
    value, what = arrays[name], draw(st.integers(0, 9))
    if name == "text" or what == 9:
        text = json.loads(str(arrays["text"])) if "text" in arrays and arrays["text"].dtype.kind == "U" else {}
        place = draw(st.sampled_from([text, text.get("outcome", text)]))
        if place:
            place[draw(st.sampled_from(sorted(place)))] = draw(
                st.sampled_from([*ODD, [[0.0, 1]], [["x", "y"]], [[1e9, "a"]]])
            )
        arrays["text"] = np.array(draw(st.sampled_from([json.dumps(text)] * 5 + ["", "{", "[]", "null"])))
    elif what == 0:
        del arrays[name]
    elif what == 1:
        arrays[name] = value[: draw(st.integers(0, max(len(value) - 1, 0)))]
    elif what == 2 and value.dtype.kind == "f" and value.size:
        value.flat[draw(st.integers(0, value.size - 1))] = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e300]))
    elif what == 3:
        arrays = {n: a[:0] if a.ndim else a for n, a in arrays.items()}
    elif what == 4:
        arrays = {n: a[:1] if a.ndim and not n.startswith("picture") else a for n, a in arrays.items()}
    elif what == 5:
        arrays[name] = value.astype(draw(st.sampled_from(["U8", "complex", "int8", "float16", "bool"])))
    elif what == 6:
        arrays[name] = np.array([{"a": 1}], object)
    elif what == 7 and value.ndim > 1:
        arrays[name] = value[:, :-1]
    else:
        arrays[name] = value[..., None]
    held = io.BytesIO()
    np.savez(held, **arrays)
    return held.getvalue()


def records(bases: Bases) -> st.SearchStrategy[Case]:
    """Records, for the figures and the automaton."""
    readers = (
        ("figures", ["--weights", "weights", "--records", "B.npz"]),
        ("analysis", ["modes", "--out", "out", "--records", "B.npz"]),
    )

    @st.composite
    def cases(draw: Any) -> Case:
        program, argv = draw(st.sampled_from(readers))
        files = needed(bases, ("weights",))
        files["B.npz"] = draw(changed(bases.record, _npz, (bases.demos, bases.candidate)))
        return Case("records", program, argv, files, ("B.npz", "records"))

    return cases()


def _lines(draw: Any, content: bytes) -> bytes:
    """Rows, of which one is changed."""
    lines = content.split(b"\n")[:-1]
    number = draw(st.integers(0, len(lines) - 1))
    entry, what = json.loads(lines[number]), draw(st.integers(0, 5))
    if what <= 2:
        inner = entry[draw(st.sampled_from([k for k in entry if isinstance(entry[k], dict)]))]
        inner[draw(st.sampled_from(sorted(inner)))] = draw(st.sampled_from(ODD))
    elif what == 3:
        inner = entry[draw(st.sampled_from([k for k in entry if isinstance(entry[k], dict)]))]
        del inner[draw(st.sampled_from(sorted(inner)))]
    elif what == 4:
        entry = draw(st.sampled_from(ODD))
    else:
        entry[draw(st.sampled_from(sorted(entry)))] = draw(st.sampled_from(ODD))
    lines[number] = json.dumps(entry).encode()
    return b"\n".join(lines) + b"\n"


def change_table(draw: Any, content: bytes) -> bytes:
    """A table with a column changed."""
    import pandas as pd

    frame = pd.read_parquet(io.BytesIO(content))
    name, what = draw(st.sampled_from(sorted(frame.columns))), draw(st.integers(0, 5))
    if what == 0:
        frame = frame.drop(columns=name)
    elif what == 1:
        frame = frame[:0]
    elif what == 2:
        frame[name] = draw(st.sampled_from([0, -1, 1.5, "x", "", None, True, 1e308]))
    elif what == 3:
        frame[name] = [[1, 2]] * len(frame)
    elif what == 4:
        frame = frame.rename(columns={name: f"old_{name}"})
    else:
        frame = pd.concat([frame, frame])
    held = io.BytesIO()
    frame.to_parquet(held)
    return held.getvalue()


def change_report(draw: Any, content: bytes) -> bytes:
    """A report with an entry changed, at some depth."""
    report = json.loads(content)
    place = report
    for _ in range(draw(st.integers(0, 3))):
        inner = [value for value in place.values() if isinstance(value, dict) and value]
        if not inner:
            break
        place = draw(st.sampled_from(inner))
    name = draw(st.sampled_from(sorted(place)))
    if draw(st.booleans()):
        place[name] = draw(st.sampled_from(ODD))
    else:
        del place[name]
    return json.dumps(report).encode()


def sweeps(bases: Bases) -> st.SearchStrategy[Case]:
    """Folders of sweeps that are gone on with, drawn, or put into the cycle; and its reports."""
    folder = {f"sweep/{name}": content for name, content in bases.sweep.items()}
    asked = ["--weights", "weights", *SWEEP, "--out", "sweep"]
    readers = (
        ("sweep", asked, folder, "sweep/rows.jsonl"), ("sweep", asked, folder, "sweep/episodes.parquet"),
        ("figures", ["--weights", "weights", "--sweep", "sweep"], folder, "sweep/episodes.parquet"),
        *(("analysis", ["cycle", "--out", "out", "--sweep", "sweep"], bases.reports, name) for name in bases.reports),
    )  # fmt: skip

    @st.composite
    def cases(draw: Any) -> Case:
        program, argv, files, name = draw(st.sampled_from(readers))
        files = needed(bases, ("weights",)) | files
        inside = {"jsonl": _lines, "parquet": change_table, "json": change_report}[name.rsplit(".")[-1]]
        files[name] = draw(changed(files[name], inside, (bases.candidate,)))
        if program == "sweep":  # its folder is its own
            files = {("out" + n.removeprefix("sweep") if n.startswith("sweep/") else n): c for n, c in files.items()}
            argv = [*argv[:-1], "out"]
        return Case(
            "sweeps and reports", program, argv, files, (name.split("/")[-1], "report", "sweep", "out ", " differ in ")
        )

    return cases()


def _checkpoint(draw: Any, content: bytes) -> bytes:
    """A checkpoint with an entry changed."""
    import torch

    stored = torch.load(io.BytesIO(content), weights_only=True)
    name = draw(st.sampled_from(sorted(stored)))
    what = draw(st.integers(0, 3))
    inner = stored[name]
    if what == 0:
        del stored[name]
    elif what == 1 or not isinstance(inner, dict):
        stored[name] = draw(st.sampled_from([*ODD, 3, 4, 10**9]))
    else:
        key = draw(st.sampled_from(sorted(inner, key=str)))
        if isinstance(inner[key], torch.Tensor):
            shapes = [
                inner[key] * float("nan"),
                inner[key].reshape(-1)[:-1],
                torch.zeros(3),
                inner[key].to(torch.complex64),
            ]
            inner[key] = draw(st.sampled_from(shapes))
        else:
            inner[key] = draw(st.sampled_from(ODD))
    held = io.BytesIO()
    torch.save(stored, held)
    return held.getvalue()


def _table(draw: Any, content: bytes) -> bytes:
    """A log with a cell changed."""
    lines = content.decode().splitlines()
    number = draw(st.integers(0, len(lines) - 1))
    cells = lines[number].split(",")
    cells[draw(st.integers(0, len(cells) - 1))] = draw(
        st.sampled_from(["", "x", "nan", "-1", "1e9", "\u00fc", '"', "3.5"])
    )
    lines[number] = ",".join(cells)
    return "\n".join(lines).encode()


def _features(draw: Any, content: bytes) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    name = draw(st.sampled_from(sorted(arrays)))
    value = arrays[name]
    if name == "key" or draw(st.integers(0, 3)) == 0:
        del arrays[name]
    elif draw(st.booleans()):
        arrays[name] = draw(st.sampled_from([value[:-3], value[:, :-1], value[:0], value.astype("U5"), value[None]]))
    else:
        value[0] = draw(st.sampled_from([np.nan, np.inf, 1e30]))
    held = io.BytesIO()
    np.savez(held, **arrays)
    return held.getvalue()


def checkpoints(bases: Bases) -> st.SearchStrategy[Case]:
    """The folder of a training that was broken off, gone on with."""
    inside = {"ckpt": _checkpoint, "npz": _features, "csv": _table}

    @st.composite
    def cases(draw: Any) -> Case:
        argv = draw(st.sampled_from([RNN, CAE, RECALL]))
        begun = bases.trainings[argv[0]]
        files = needed(bases, ("weights", "demos", "candidate")) | begun
        changeable = sorted(name for name in begun if name.rsplit(".")[-1] in inside)
        name = draw(st.sampled_from([*(name for name in changeable if name.endswith("ckpt")), *changeable]))
        files[name] = draw(changed(files[name], inside[name.rsplit(".")[-1]], (bases.candidate, bases.record)))
        return Case("checkpoints", "training", argv, files, (name.split("/")[-1],))

    return cases()
