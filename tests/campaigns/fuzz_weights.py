"""Weight files with their bytes or their contents changed."""

import json
from typing import Any

from hypothesis import strategies as st

from tests.campaigns.fuzz_bases import BENCH, RECALL, RNN, SWEEP, Bases
from tests.campaigns.fuzz_case import Case
from tests.campaigns.fuzz_changes import ODD, changed
from tests.campaigns.fuzz_inputs import needed


def change_graph(draw: Any, content: bytes) -> bytes:
    """A graph whose header or whose tensors are changed."""
    import onnx

    model = onnx.load_from_string(content)
    [entry] = [pair for pair in model.metadata_props if pair.key == "header"]
    header = json.loads(entry.value)
    what = draw(st.integers(0, 9))
    if what <= 5:
        name = draw(st.sampled_from(sorted(header)))
        if draw(st.integers(0, 5)) == 0:
            del header[name]
        else:
            header[name] = draw(st.sampled_from(ODD))
        entry.value = json.dumps(header)
    elif what == 6:
        entry.value = draw(st.sampled_from(["", "{", "[]", "null", "5", "[" * 100_000, '{"kind": "policy"}', '"x"']))
    elif model.graph.initializer:
        tensor = draw(st.sampled_from(list(model.graph.initializer)))
        if what == 7:
            del tensor.dims[:]
            tensor.dims.extend(draw(st.sampled_from([[], [0], [1], [-1], [2**40], [2**31, 2**31], [3, 5], [1] * 300])))
        elif what == 8:
            tensor.data_type = draw(st.integers(0, 30))
        else:
            tensor.raw_data = draw(
                st.sampled_from([b"", b"\0", b"\xff" * len(tensor.raw_data), bytes(len(tensor.raw_data))])
            )
    return model.SerializeToString()


def change_tensors(draw: Any, content: bytes) -> bytes:
    """A file whose JSON is changed."""
    size = int.from_bytes(content[:8], "little")
    outer, rest = json.loads(content[8 : 8 + size]), content[8 + size :]
    inner = json.loads(outer["__metadata__"]["header"])
    what = draw(st.integers(0, 5 if len(outer) > 1 else 3))
    if what <= 2:
        place = draw(st.sampled_from([inner, *(v for v in inner.values() if isinstance(v, dict) and v)]))
        if place is inner.get("calibrations"):
            place = draw(st.sampled_from([place, *place.values()]))
        name = draw(st.sampled_from(sorted(place)))
        place[name] = draw(st.sampled_from(ODD))
        outer["__metadata__"]["header"] = json.dumps(inner)
    elif what == 3:
        outer["__metadata__"]["header"] = draw(st.sampled_from(["", "{", "[]", "null", "5", "[" * 100_000]))
    else:
        tensor = outer[draw(st.sampled_from([name for name in outer if name != "__metadata__"]))]
        entry = draw(st.sampled_from(["dtype", "shape", "data_offsets"]))
        tensor[entry] = draw(
            st.sampled_from(["F16", "BOOL", "I64", "X", [], [0], [1], [2**40, 8], [0, 2**62], [8, 0], None])
        )
    text = json.dumps(outer).encode()
    return len(text).to_bytes(8, "little") + text + rest


def weights(bases: Bases) -> st.SearchStrategy[Case]:
    """Each weight file under each program that reads it."""
    fly = ["--weights", "weights"]
    readers = {
        "weights/encoder.onnx": [
            ("sweep", [*fly, *SWEEP, "--out", "out"], ("weights",)),
            ("bench", [*BENCH, "--out", "out"], ("weights",)),
            ("training", ["probe", "--data", "demos.h5", "--encoder", "weights/encoder.onnx"], ("demos",)),
            ("training", RNN, ("demos",)),
        ],
        "weights/decoder.onnx": [("figures", [*fly, "--records", "B.npz"], ("record",)),
        ("live", [*fly, "--no-open"], ())],
        "weights/lstm.onnx": [
            ("sweep", [*fly, *SWEEP, "--out", "out"], ()),
            ("bench", [*BENCH, "--out", "out"], ()),
            ("pick_place", [*fly, "--disturbance", "none"], ()),
            ("calibrate", ["--candidates", "weights/lstm.onnx", "--encoder", "weights/encoder.onnx", "--out",
            "new.onnx"], ()),
            ("baselines", ["--policies", "weights/lstm.onnx", "--data", "demos.h5", "--encoder",
            "weights/encoder.onnx"],
             ("demos",)),
            ("analysis", ["resume", "--out", "out", *fly], ()),
            ("analysis", ["states", "--out", "out", *fly], ()),
            ("figures", fly, ()),
        ],
        "weights/knn.safetensors": [
            ("sweep", [*fly, *SWEEP, "--out", "out", "--detector", "knn"], ()),
            ("pick_place", [*fly, "--disturbance", "none", "--detector", "knn"], ()),
            ("baselines", ["--policies", "weights/lstm.onnx", "--data", "demos.h5", "--encoder",
            "weights/encoder.onnx"],
             ("demos",)),
        ],
        "weights/subspace.safetensors": [("sweep", [*fly, *SWEEP, "--out", "out", "--detector", "subspace"], ())],
        "rnn-4.onnx": [
            ("training", RECALL, ("demos", "candidate")),
            ("training", [*RNN, "--start-from", "rnn-4.onnx"], ("demos", "candidate")),
        ],
        "policy-4.onnx": [
            ("analysis", ["linearize", "--out", "out", "--policies", "policy-4.onnx", "--encoder",
            "weights/encoder.onnx"],
             ("policy",)),
            ("calibrate", ["--candidates", "policy-4.onnx", "--encoder", "weights/encoder.onnx", "--out", "new.onnx"],
             ("policy",)),
        ],
    }  # fmt: skip
    others = (*bases.weights.values(), bases.candidate, bases.policy, bases.record)

    @st.composite
    def cases(draw: Any) -> Case:
        name = draw(st.sampled_from(sorted(readers)))
        program, argv, needs = draw(st.sampled_from(readers[name]))
        # The detectors' files are of another call of baselines.py, which would be refused for that.
        alone = program == "baselines" and name == "weights/lstm.onnx"
        files = needed(bases, ("policies" if alone else "weights", *needs))
        inside = change_tensors if name.endswith("safetensors") else change_graph
        files[name] = draw(changed(files[name], inside, others))
        return Case(f"weights {name.split('/')[-1]}", program, argv, files, (name.split("/")[-1], "the policy was"))

    return cases()


def autoencoders(bases: Bases) -> st.SearchStrategy[Case]:
    """The autoencoder of `training cae`, which is large."""
    argv = ["export", "--data", "demos.h5", "--autoencoder", "cae.safetensors", "--out", "out", "--pictures", "2"]

    @st.composite
    def cases(draw: Any) -> Case:
        files = needed(bases, ("demos",))
        files["cae.safetensors"] = draw(changed(bases.autoencoder, change_tensors, tuple(bases.weights.values())))
        return Case("autoencoders", "training", argv, files, ("cae.safetensors",))

    return cases()
