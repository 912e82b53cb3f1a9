"""Signal temporal logic by hand: values, truth, the text, and tick by tick."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from models.errors import InputError
from systems.requirement_monitor import RequirementMonitor
from systems.signal_logic import holds, robustness, signal_names
from systems.signal_logic_text import DEEPEST, load_requirements, parse_requirements

INF = np.inf
A = [1.0, -2.0, 3.0, 0.5, -1.0]
B = [-1.0, 2.0, -1.0, -1.0, 4.0]


def parse(text, period=0.1):
    return parse_requirements(text, ("a", "b"), period, "this.stl")


def value(formula, a=A, b=B, period=0.1):
    found = robustness(parse(f"require it: {formula}", period)["it"], {"a": np.array(a), "b": np.array(b)})
    return found.tolist()


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("a > 0", A),
        ("a < 1", [0.0, 3.0, -2.0, 0.5, 2.0]),
        ("a >= b", [2.0, -4.0, 4.0, 1.5, -5.0]),
        ("2 * a - abs(b + 1) + 1 <= 0.5 * b", [-3.5, 7.0, -7.5, -2.5, 8.0]),
        ("-a < b", [0.0, 0.0, 2.0, -0.5, 3.0]),
        ("not a > 0", [-1.0, 2.0, -3.0, -0.5, 1.0]),
        ("a > 0 and b > 0", [-1.0, -2.0, -1.0, -1.0, -1.0]),
        ("a > 0 or b > 0", [1.0, 2.0, 3.0, 0.5, 4.0]),
        ("a > 0 implies b > 0", [-1.0, 2.0, -1.0, -0.5, 4.0]),
        ("always a > 0", [-2.0, -2.0, -1.0, -1.0, -1.0]),
        ("eventually a > 0", [3.0, 3.0, 3.0, 0.5, -1.0]),
        ("historically a > 0", [1.0, -2.0, -2.0, -2.0, -2.0]),
        ("once a > 0", [1.0, 1.0, 3.0, 3.0, 3.0]),
        ("once[1:2 tick] a > 0", [-INF, 1.0, 1.0, 3.0, 3.0]),
        ("historically[2:inf tick] a > 0", [INF, INF, 1.0, -2.0, -2.0]),
        ("eventually[1:2 tick] a > 0", [3.0, 3.0, 0.5, -1.0, -INF]),
        ("always[0.1:0.2 s] a > 0", [-2.0, 0.5, -1.0, -1.0, INF]),
        ("always[9:20 tick] a > 0", [INF] * 5),
        # From k on a holds until b does: the best b, held back by the worst a before it.
        ("a > 0 until b > 0", [1.0, 2.0, 0.5, 0.5, 4.0]),
        ("a > 0 until[1:1 tick] b > 0", [1.0, -2.0, -1.0, 0.5, -INF]),
        ("a > 0 until[2:inf tick] b > 0", [-2.0, -2.0, 0.5, -INF, -INF]),
        ("a > 0 since b > 0", [-1.0, 2.0, 2.0, 0.5, 4.0]),
        ("a > 0 since[1:2 tick] b > 0", [-INF, -2.0, 2.0, 0.5, -1.0]),
        ("a > 0 since[1:inf tick] b > 0", [-INF, -2.0, 2.0, 0.5, -1.0]),
        # Weakest first: implies, or, and, until.
        ("a > 0 and b > 0 or a > 0", A),
        ("a > 0 or b > 0 implies a > 0", [1.0, -2.0, 3.0, 0.5, -1.0]),
        ("not (a > 0 and b > 0)", [1.0, 2.0, 1.0, 1.0, 1.0]),
    ],
)
def test_values_by_hand(formula, expected):
    assert value(formula) == pytest.approx(expected)


def test_at_the_bound_truth_depends_on_the_sign():
    signals = {"a": np.array([0.0, 1.0]), "b": np.array([0.0, 0.0])}
    formulas = parse("require strict: a > 0 require weak: a >= 0 require inside: not a > 0")
    assert [holds(f, signals).tolist() for f in formulas.values()] == [[False, True], [True, True], [True, False]]
    assert all(robustness(f, signals)[0] == 0.0 for f in formulas.values())


def test_seconds_are_rounded_to_ticks():
    assert value("once[0.14:0.16 s] a > 0") == value("once[1:2 tick] a > 0")
    assert value("once[0:6 s] a > 0", period=2.0) == value("once[0:3 tick] a > 0")


def test_names_stand_for_formulas_and_comments_for_nothing():
    text = """
    # first
    let up = a > 0   # second
    let both = up and b > 0
    require one: always up
    require two:
        eventually
        both
    """
    found = parse(text)
    assert list(found) == ["one", "two"]
    signals = {"a": np.array(A), "b": np.array(B)}
    assert [robustness(f, signals)[0] for f in found.values()] == [-2.0, -1.0]
    assert (signal_names(found["one"]), signal_names(found["two"])) == ({"a"}, {"a", "b"})


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "line 1: there is no requirement in it"),
        ("let up = a > 0", "there is no requirement"),
        ("require it: a > 0\nrequire it: b > 0", "line 2: the name 'it' is given twice"),
        ("let a = b > 0", "the name 'a' is given twice"),
        ("let not = b > 0", "a name should stand where 'not' does"),
        ("require it:\n\n c > 0", "line 3: there is no signal 'c' .there are a, b."),
        ("require it: a > 0 )", "'let' or 'require' should stand where '.' does"),
        ("require it: (a > 0", "'.' should stand where 'the end' does"),
        ("require it: a", "<, <=, > or >= should stand where 'the end' does"),
        ("require it: a > 0 and", "there is no signal 'the end'"),
        ("require it: 2 * 3 > a", "there is no signal '3'"),
        ("require it: a > 1e999", "a number should stand where '1e999' does"),
        ("require it: a ? 0", r"line 1: '\?' has no meaning"),
        ("require it: once[0:6] a > 0", "'s' or 'tick' should stand where ']' does"),
        ("require it: once[1:0.2 s] a > 0", "ends, after 0.2 s, before it begins, after 1"),
        ("require it: once[0.5:2 tick] a > 0", "the bound 0.5 tick is no whole number of ticks"),
        ("require it: once[0:1e300 s] a > 0", r"the bound 1e\+300 s is no whole number of ticks up to 10000"),
        ("require it: " + "(" * 1000 + "a > 0" + ")" * 1000, f"more than {DEEPEST} brackets"),
        ("require it: " + "not " * 1000 + "a > 0", f"more than {DEEPEST} brackets"),
    ],
)
def test_what_does_not_fit_is_named_with_its_line(text, named):
    with pytest.raises(InputError, match=f"this.stl, line .*{named}|{named}"):
        parse(text)


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00"])
def test_a_file_that_cannot_be_read(tmp_path, content):
    path = tmp_path / "r.stl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"r.stl cannot be read .*give a text file in UTF-8"):
        load_requirements(path, ("a",), 0.1)


def test_signals_of_no_or_unequal_length_are_refused():
    formula = parse("require it: a > b")["it"]
    for a, b in (([], []), ([1.0], [1.0, 2.0])):
        with pytest.raises(ValueError, match="one at least"):
            robustness(formula, {"a": np.array(a), "b": np.array(b)})


# While it runs.


@pytest.mark.parametrize(
    "formula",
    ["a > 0", "once a > 0", "always eventually a > 0", "always[0:3 tick] a > 0", "always (a > 0 until b > 0)",
     "(always a > 0) and b > 0", "a > 0 until b > 0"],
)  # fmt: skip
def test_what_looks_ahead_cannot_be_watched(formula):
    with pytest.raises(InputError, match="the requirement it cannot be watched: make it a combination of always"):
        RequirementMonitor(parse(f"require it: {formula}"), ("a", "b"))


def test_the_monitor_says_what_the_arrays_say_of_the_ticks_so_far():
    formulas = parse(
        "let seen = once[1:2 tick] b > 0 require one: always (seen implies a > 0) "
        "require two: not eventually (a > 0 since[0:3 tick] b > 0) or always a > -3 + b"
    )
    system = RequirementMonitor(formulas, ("a", "b"), 0.1)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.get_input_port().FixValue(context, [-100.0, 100.0])  # before the first tick: of no run
    for k, row in enumerate(zip(A, B, strict=True)):
        simulator.AdvanceTo(k * 0.1 + 0.01)
        system.get_input_port().FixValue(context, row)
        so_far = {"a": np.array(A[: k + 1]), "b": np.array(B[: k + 1])}
        expected = [robustness(formula, so_far)[0] for formula in formulas.values()]
        for share in (0.02, 0.09):  # anywhere in the tick
            simulator.AdvanceTo(k * 0.1 + share)
            assert system.get_output_port().Eval(context).tolist() == expected
