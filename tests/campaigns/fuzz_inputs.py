"""What the campaign feeds the programs: command lines and files, valid ones and what is a step or a leap from them."""

import dataclasses
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from diagrams import analysis, baselines, bench, calibrate, figures, live, pick_place, sweep, teach
from diagrams.monitors import coverage, export, offline
from models.training import __main__ as training
from tests.campaigns.fuzz_bases import BENCH, OFFLINE, RECALL, RNN, SWEEP, Bases
from tests.campaigns.fuzz_case import Case, Special

NUMBERS = (
    "0", "-1", "1", "2", "3", "-0.5", "0.5", "1.5", "nan", "-nan", "inf", "-inf", "1e308", "1e999", "-1e308", "1e-320",
    "100000", "1000000000", "2147483648", "9223372036854775808", "99999999999999999999999999", "1e9", "1e3", "0x10",
    "1_000", "1,5", "\uff11\uff12", "+3", "-0", "--3", "", " ", "abc", "True", "None", "1 2", "NaN", "9" * 5000,
)  # fmt: skip
STRINGS = (
    "lstm", "gru", "mtrnn", "recall", "knn", "subspace", "never", "A", "B", "none", "moved", "left", "oracle",
    "ensemble", "rnd", "pyod:IForest", "pyod:", "conformal", "camera_gain", "push_hand", "can_toppled", "payload",
    "", " ", "a/b",
    "../x", "no:Class", ":", "os:path", "json:nothing", "tests.models.outside:NoNetwork",
    "tests.models.own_policies:Drift",
    "tests.models.own_policies:Remembering", "tests.models.outside:Elman", "x" * 300, "\u00fc\u4e2d", "\udcff", "a\nb",
    "None", "nan", "tcp:", "cpu", "meta", "cuda:7", "mps", "%s", "{}", "lstm.onnx", "pick_place.dmd.yaml",
)  # fmt: skip
PATHS = (
    "absent", "absent/deep.npz", "", ".", "..", "folder", "fifo", "zero", "note.txt", "note.txt/below", "empty",
    "a b \u00fc.json", "x" * 300, "\udcff.npz", "weights", "weights/lstm.onnx", "weights/encoder.onnx", "demos.h5",
    "B.npz",
    "sweep", "out", "/proc/version/x", "same.png", "same.svg", "same.html", "same.npz", "world.yaml", "a\nb.png",
    "out.h5",
    "policy.onnx", "knn.safetensors", "f.webp", "f.gif", "f.mp4", "f.mcap", "f.json",
)  # fmt: skip
NOTES = {
    "folder": Special("folder"), "fifo": Special("fifo"), "zero": Special("zero"), "note.txt": b"mine\n", "empty": b"",
    "world.yaml": b"regulator: {input_weight: 90.0}\n",
}  # fmt: skip
UNASKED = {"--scheduler", "--profile", "--meshcat", "--open"}  # a cluster has a campaign of its own


@dataclasses.dataclass(frozen=True)
class Program:
    """A program, the files that its base command line needs, and that command line."""

    options: Any  # its dataclass
    base: list[str]
    needs: tuple[str, ...] = ("weights",)
    words: tuple[str, ...] = ()  # the subcommand


def programs() -> dict[str, Program]:
    """By the name of the program and its subcommand."""
    weights = ["--weights", "weights"]
    found = {
        "pick_place": Program(pick_place.PickPlaceArguments, [*weights, "--disturbance", "none"]),
        "teach": Program(teach.TeachArguments, ["--out", "out.h5", "--limit", "1"], ()),
        "calibrate": Program(
            calibrate.CalibrateArguments,
            ["--candidates", "weights/lstm.onnx", "--encoder", "weights/encoder.onnx", "--out", "new.onnx"],
        ),
        "baselines": Program(
            baselines.BaselinesArguments,
            ["--policies", "weights/lstm.onnx", "--data", "demos.h5", "--encoder", "weights/encoder.onnx"],
            ("policies", "demos"),
        ),
        "sweep": Program(sweep.SweepArguments, [*weights, *SWEEP, "--out", "out"]),
        "bench": Program(bench.BenchArguments, [*BENCH, "--out", "out"]),
        "bench export": Program(
            export.Export, ["--bench", "bench", "--out", "new", "--workers", "0"], ("bench",), ("export",)
        ),
        "bench coverage": Program(
            coverage.Coverage, ["--bench", "bench", "--out", "new", "--workers", "0"], ("bench",), ("coverage",)
        ),
        "bench offline": Program(offline.Offline, ["--data", "robomimic.hdf5", *OFFLINE], ("runs",), ("offline",)),
        "figures": Program(figures.FiguresArguments, [*weights, "--records", "B.npz"], ("weights", "record")),
        "live": Program(live.LiveArguments, [*weights, "--no-open"]),
    }
    for name, kind in analysis.ANALYSES.items():
        base, needs = ["--out", "out"], ("weights",)
        hints = get_type_hints(kind)
        if "weights" in hints:
            base += weights
        if name == "modes":
            base, needs = [*base, "--records", "B.npz"], ("weights", "record")
        if name == "linearize":
            base += ["--policies", "policy-4.onnx", "--encoder", "weights/encoder.onnx"]
            needs = ("weights", "policy")
        if name == "cycle":
            base, needs = [*base, "--sweep", "sweep"], ("reports",)
        found[f"analysis {name}"] = Program(kind, base, needs, (name,))
    bases = {
        "cae": (["--data", "demos.h5", "--out", "out", "--batch-size", "2", "--max-images", "2"], ("demos",)),
        "export": (["--data", "demos.h5", "--autoencoder", "absent", "--out", "out", "--pictures", "2"], ("demos",)),
        "rnn": (RNN[1:], ("weights", "demos")),
        "recall": (RECALL[1:], ("weights", "demos", "candidate")),
        "probe": (["--data", "demos.h5", "--encoder", "weights/encoder.onnx"], ("weights", "demos")),
    }
    for name, (kind, _) in training.commands().items():
        found[f"training {name}"] = Program(kind, *bases[name], (name,))
    return found


def needed(bases: Bases, needs: tuple[str, ...]) -> dict[str, bytes | Special]:
    """The valid files that a command line speaks of."""
    found: dict[str, bytes | Special] = dict(NOTES)
    made: dict[str, Callable[[], dict[str, bytes]]] = {
        "weights": bases.write_weights,
        "policies": lambda: bases.write_weights(("encoder.onnx", "lstm.onnx")),
        "demos": lambda: {"demos.h5": bases.demos},
        "record": lambda: {"B.npz": bases.record},
        "candidate": lambda: {"rnn-4.onnx": bases.candidate},
        "policy": lambda: {"policy-4.onnx": bases.policy},
        "reports": lambda: bases.reports,
        "bench": lambda: {f"bench/{name}": content for name, content in bases.bench.items()},
        "runs": lambda: bases.runs,
        "sweep": lambda: {f"sweep/{name}": content for name, content in bases.sweep.items()},
    }
    for name in needs:
        found |= made[name]()
    return found


def options_of(kind: Any, prefix: str = "") -> list[tuple[str, Any]]:
    """The options of a dataclass as tyro names them, with their types."""
    found = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if name.isupper() or name not in {f.name for f in dataclasses.fields(kind)}:
            continue
        option, plain = f"{prefix}{name}".replace("_", "-"), hint
        for part in getattr(hint, "__metadata__", ()):
            if type(part).__name__ == "_Suppress" or "SUPPRESS" in repr(part).upper():
                plain = None
            if (given := getattr(part, "name", None)) is not None:
                option = given
        if plain is None:
            continue
        plain = hint.__origin__ if hasattr(hint, "__metadata__") else hint
        if dataclasses.is_dataclass(plain):
            found += options_of(plain, f"{option}.")
        elif f"--{option}" not in UNASKED:
            found.append((f"--{option}", plain))
    return found


def value_of(draw: Any, hint: Any) -> list[str]:
    """Words for an option of that type; mostly of its type, seldom right."""
    origin = get_origin(hint)
    if hint is bool:
        return []
    if origin is Literal:
        return [draw(st.sampled_from([*map(str, get_args(hint)), "", "other", "0"]))]
    if origin in (Union, types.UnionType):
        return value_of(draw, draw(st.sampled_from([part for part in get_args(hint) if part is not type(None)])))
    if origin in (list, tuple):
        inner = get_args(hint)[0]
        return [word for _ in range(draw(st.integers(0, 3))) for word in value_of(draw, inner)]
    pool = {int: NUMBERS, float: NUMBERS, str: STRINGS, Path: PATHS}.get(hint, STRINGS)
    if draw(st.integers(0, 19)) == 0:  # of another type
        pool = draw(st.sampled_from([NUMBERS, STRINGS, PATHS]))
    return [draw(st.sampled_from(pool))]


def command_lines(name: str, program: Program, bases: Bases) -> st.SearchStrategy[Case]:
    """The base command line with one to three options more, or something that is no option."""
    options = options_of(program.options)
    first = name.split()[0]

    @st.composite
    def cases(draw: Any) -> Case:
        words, names = list[str](), list[str]()
        for _ in range(draw(st.sampled_from([1, 1, 1, 2, 2, 3]))):
            strange = draw(st.integers(0, 24))
            option, hint = draw(st.sampled_from(options))
            if strange == 0:
                words.append(
                    draw(st.sampled_from(["--none-such", "-x", "--", "stray", "--help", "", "-", "--=", option]))
                )
                names = [""]
                continue
            values = value_of(draw, hint)
            if hint is bool and draw(st.booleans()):
                option = "--no-" + option[2:]
            names += [
                option,
                *values,
                *(value.replace("_", "").removeprefix("+") for value in values),
                option[2:].replace("-", "_"),
                option[2:].replace("-", " ").replace(".", " "),
            ]
            names += [part.replace("-", " ") for part in option[2:].split(".")[-2:]]
            words += [f"{option}={values[0]}"] if strange == 1 and values else [option, *values]
        names += [word for word in program.base if word == "absent"]
        argv = [*program.words, *program.base, *words]
        if draw(st.integers(0, 29)) == 0:
            argv.pop(draw(st.integers(0, len(argv) - 1)))
            names = [""]
        return Case(f"arguments of {name}", first, argv, needed(bases, program.needs), tuple(n[:40] for n in names))

    return cases()
