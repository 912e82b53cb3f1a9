"""Scenario and world files: valid trees with keys and values changed, and texts that are none."""

import dataclasses
from typing import Any

from hypothesis import strategies as st

from diagrams.world.configuration import World
from tests.campaigns.fuzz_bases import SWEEP, Bases
from tests.campaigns.fuzz_case import Case
from tests.campaigns.fuzz_inputs import needed

SCALARS = (
    "0", "-1", "1", "2", "3.5", "-0.5", "1e-9", "1e-320", ".nan", ".inf", "-.inf", "nan", "inf", "1e308", "1e999",
    "1e400", "100000", "1000000000", "2147483648", "9223372036854775808", "9" * 400, "0x1F", "0o17", "1_000", "1:30",
    "~",
    "null", "true", "no", "''", "abc", "'1'", "[]", "{}", "[1, 2]", "[.nan, 1]", "[[1, 2], [3]]", "{a: 1}",
    "2026-01-01",
    "!!python/object/apply:os.system ['true']", "!!binary aGFsbG8=", "!!float '1'", "!tag 1", "&a 1", "*a", "? x",
    "- 1",
    "left", "A", "B", "none", "moved", "camera_gain", "push_hand", "disturbed_thrice",
    "lstm", "knn", "\"\\x00\"", "\u00fc", "'" + "x" * 5000 + "'",
    "pick_place.dmd.yaml", "../sdf/pick_place.dmd.yaml", "iiwa.dmd.yaml", "unseen", "imagined",
)  # fmt: skip
NUMBERS = SCALARS[:20]
WHOLE = (
    b"", b"\n", b"# nothing\n", b"---\n", b"---\n...\n", b"null\n", b"~", b"5\n", b"text\n", b"[]\n", b"{}\n",
    b"- 1\n- 2\n",
    b"\xff\xfe\x00", b"\x00\x01\x02", b"a: [", b"{", b"a: b: c\n", b"\tgrid: {}\n", b"%YAML 9.9\n---\n{}\n",
    b"--- {}\n--- {}\n",
    b"[" * 5000, b"{a: " * 3000, b"a: " + b"x" * 3_000_000, b"? [1, 2]\n: 3\n", b"1: 2\n", b"true: false\n",
    b"world:\n",
    b"world: null\n", b"disturbance: none\n", b"disturbance: null\n", b"disturbance: []\n", b"world: default\n",
    b"grid: null\n",
    b"hands: null\n", b"hands: {grip: 5}\n", b"seed: null\n", b"<<: {seed: 1}\n", b"!!set {a, b}\n", b"grid: [1, 2]\n",
    b"a: &a [x, x, x, x, x, x, x, x, x]\n" + b"".join(
        f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join(['*' + chr(97 + n)] * 9)}]\n".encode() for n in range(9)
    ),
    b"a: &a\n  b: *a\n", b"seed: 1\nseed: 2\n", b"grid: {count: 10, count: 12}\n", b"world: {}\nworld: {}\n",
    b"seed: 1\n" * 2000, b"".join(b"k%d: 1\n" % n for n in range(20_000)),
)  # fmt: skip
ENCODINGS = ("utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-32", "latin-1")

Tree = dict[str, Any]
SCENARIOS: list[Tree] = [
    {"disturbance": {"kind": "none"}},
    {"disturbance": {"kind": "A", "level": 0.15, "subtask": 1, "hold_ticks": 10,
                     "target": [0.1, 0.5, 0.0, 1.2, 0.0, 0.9, 0.0]}},
    {"disturbance": {"kind": "B", "level": 0.1, "subtask": 2, "hold_ticks": 20, "can_moved_to": [0.5, 0.0]}},
    {"disturbance": {"kind": "moved", "level": 0.1, "subtask": 1, "can_moved_to": [0.5, 0.02]}, "can": [0.5, 0.05]},
    {"seed": 3, "can": [0.52, 0.0], "vacant": "left", "disturbance": {"kind": "none"}},
    {"disturbance": {"kind": "none"}, "hands": {"grip": [[3, 1, 0, 0, 0, 0, 0, 0, 0]], "force": [[5, 1, 2, 3]],
     "can": [[9, 0.5, 0.0]], "camera": [[4, 1]], "gamma": [[2, 20.0]], "late": [[6, 0.5]]}},
    {"disturbance": {"kind": "none"}, "world": {"regulator": {"input_weight": 45.0}}},
    {"disturbance": {"kind": "camera_gain", "severity": 0.5}},
    {"disturbance": {"kind": "push_hand", "level": 0.1, "subtask": 1, "hold_ticks": 10, "severity": 0.5}},
    {"disturbance": {"kind": "disturbed_return", "level": 0.15, "subtask": 1, "hold_ticks": 10, "severity": 1.0,
                     "target": [0.1, 0.5, 0.0, 1.2, 0.0, 0.9, 0.0, 0.1, 0.6, 0.0, 1.3, 0.0, 0.9, 0.0]}},
    {"disturbance": {"kind": "can_moved", "level": 0.1, "subtask": 1, "hold_ticks": 0, "can_moved_to": [0.5, 0.02],
                     "severity": 1.0}},
]  # fmt: skip


def world_tree() -> Tree:
    """The default world."""
    return dataclasses.asdict(World())


def text_of(node: Any, indent: int = 0) -> str:
    """A tree as YAML; what is no dict, list or number is written as it stands."""
    if not isinstance(node, dict):
        return str(node)
    if not node:
        return "{}"
    lines = []
    for key, value in node.items():
        key = str(key).split("\0")[0]  # so that a key can come twice
        below = isinstance(value, dict) and value
        lines.append("  " * indent + f"{key}:" + ("\n" + text_of(value, indent + 1) if below else f" {text_of(value)}"))
    return "\n".join(lines)


def paths_of(tree: Tree, before: tuple = ()) -> list[tuple]:
    """Where its nodes are."""
    found = []
    for key, value in tree.items():
        found.append((*before, key))
        if isinstance(value, dict):
            found += paths_of(value, (*before, key))
    return found


def _prune(tree: Tree, keep: set[tuple], before: tuple) -> Tree:
    """Only what leads to `keep`: a file says what differs."""
    found = {}
    for key, value in tree.items():
        path = (*before, key)
        if path in keep:
            found[key] = value
        elif isinstance(value, dict) and any(path == kept[: len(path)] for kept in keep):
            found[key] = _prune(value, keep, path)
    return found


@st.composite
def documents(draw: Any, kind: str) -> tuple[bytes, tuple[str, ...]]:
    """A file of that `kind` (scenario, world), and the names of which a refusal has to have one."""
    if draw(st.integers(0, 7)) == 0:
        return draw(st.sampled_from(WHOLE)), ()
    base = draw(st.sampled_from(SCENARIOS)) if kind == "scenario" else world_tree()
    tree, names = _copied(base), []
    if kind == "world" and draw(st.booleans()):
        tree = _prune(tree, set(draw(st.lists(st.sampled_from(paths_of(tree)), min_size=1, max_size=3))), ())
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3]))):
        places = paths_of(tree)
        if not places:
            break
        path = draw(st.sampled_from(places))
        inner = tree
        for key in path[:-1]:
            inner = inner[key]
        what, key = draw(st.integers(0, 11)), path[-1]
        names.append(str(key))
        if what <= 6:
            number = isinstance(inner[key], int | float) and draw(st.booleans())
            inner[key] = draw(st.sampled_from(NUMBERS if number else SCALARS))
            names.append(inner[key].strip("'\"")[:40])
        elif what == 7 and isinstance(inner[key], list) and inner[key]:
            inner[key] = _bent(draw, inner[key])
        elif what == 8:
            inner[f"{key}\0"] = draw(
                st.sampled_from(["1", str(inner[key]) if not isinstance(inner[key], dict) else "{}"])
            )
        elif what == 9:
            strange = draw(st.sampled_from(["unknown", f"{key}s", "", "0", "null", "\u00fc", "x" * 2000, "__class__"]))
            inner[strange] = inner.pop(key)
            names.append(strange)
        elif what == 10:
            for _ in range(draw(st.sampled_from([1, 5, 60]))):
                inner[key] = {key: inner[key]}
        else:
            del inner[key]
    text = text_of(tree)
    if draw(st.integers(0, 9)) == 0:
        text = text.replace("\n", "\r\n")
    if draw(st.integers(0, 29)) == 0:
        text = text.replace("  ", "\t")
    content = text.encode(draw(st.sampled_from(ENCODINGS)), errors="replace")
    if draw(st.integers(0, 19)) == 0:
        content = content[: draw(st.integers(0, max(len(content) - 1, 0)))]
    return content, ("file", *names)


def _copied(tree: Tree) -> Tree:
    return {key: _copied(value) if isinstance(value, dict) else value for key, value in tree.items()}


def _bent(draw: Any, values: list) -> list:
    """The list with an entry changed, dropped or added."""
    place, bent = draw(st.integers(0, len(values) - 1)), list(values)
    what = draw(st.integers(0, 3))
    if what == 0:
        del bent[place]
    elif what == 1:
        bent.append(bent[place])
    elif isinstance(bent[place], list):
        bent[place] = _bent(draw, bent[place]) if bent[place] else [1]
    else:
        bent[place] = draw(st.sampled_from(NUMBERS))
    return bent


def worlds(bases: Bases) -> st.SearchStrategy[Case]:
    """World files, for each program that reads one."""
    programs = (
        ("sweep", ["--weights", "weights", *SWEEP, "--out", "out"], ("weights",)),
        ("teach", ["--out", "out.h5", "--limit", "1"], ()),
        ("pick_place", ["--weights", "weights", "--disturbance", "none"], ("weights",)),
        ("analysis", ["cycle", "--out", "out", "--sweep", "sweep"], ("reports",)),
        ("figures", ["--weights", "weights", "--records", "B.npz"], ("weights", "record")),
        ("calibrate", ["--candidates", "weights/lstm.onnx", "--encoder", "weights/encoder.onnx", "--out", "new.onnx"],
         ("weights",)),
    )  # fmt: skip

    @st.composite
    def cases(draw: Any) -> Case:
        program, argv, needs = draw(st.sampled_from(programs))
        content, names = draw(documents("world"))
        files = needed(bases, needs) | {"w.yaml": content}
        return Case("world files", program, [*argv, "--world", "w.yaml"], files, ("w.yaml", *names))

    return cases()


def scenarios(bases: Bases) -> st.SearchStrategy[Case]:
    """Scenario files."""

    @st.composite
    def cases(draw: Any) -> Case:
        content, names = draw(documents("scenario"))
        files = needed(bases, ("weights",)) | {"s.yaml": content}
        argv = ["--weights", "weights", "--scenario", "s.yaml"]
        return Case("scenario files", "pick_place", argv, files, ("s.yaml", *names))

    return cases()
