"""A slice of the campaign: our values of random formulas are RTAMT's."""

import sys

import numpy as np
import pytest

from models.errors import InputError
from tests.campaigns import stl
from tests.campaigns.stl import StlArguments, formula_agrees, main, record_agrees

try:
    import rtamt
except ImportError as error:  # from Python 3.13 on its parser's runtime asks for a module that is gone
    rtamt, REASON = None, f"RTAMT cannot be imported: {error}"
else:
    REASON = ""
needs_rtamt = pytest.mark.skipif(rtamt is None, reason=REASON or "RTAMT is there")


@needs_rtamt
def test_fifty_formulas_have_the_value_of_rtamt():
    assert [wrong for number in range(50) if (wrong := formula_agrees(7, number)) is not None] == []


@needs_rtamt
def test_another_value_is_found_and_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stl, "robustness", lambda formula, signals: np.full(len(signals["a"]), 1e-3))
    arguments = StlArguments(count=3, episodes=0, out=tmp_path)
    assert main(arguments) == 1
    words = capsys.readouterr().out
    assert ", by RTAMT " in words
    assert words.endswith("0 of 3 agree\n")
    monkeypatch.undo()
    assert main(arguments) == 1  # what was run is not run again
    assert main(StlArguments(count=3, episodes=0, out=tmp_path / "new")) == 0
    assert capsys.readouterr().out.endswith("3 of 3 agree\n")


def test_without_rtamt_the_campaign_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rtamt", None)
    with pytest.raises(InputError, match=r"RTAMT cannot be imported .*with Python 3.11 or 3.12"):
        main(StlArguments(count=1, episodes=0, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_record_that_disagrees_is_told():
    signals, time = np.zeros((40, 7)), 0.1 * np.arange(40)
    signals[:, 4:] = 0.05
    outcome = {"switch_success": True, "switch_failure": None, "void": False, "false_switches": 0}
    assert record_agrees(signals, time, outcome) is None
    signals[3, 0] = 0.5
    assert record_agrees(signals, time, outcome) == "by the requirements false switch, by the scoring None"
    assert record_agrees(signals, time, outcome | {"switch_failure": "false switch", "switch_success": False}) is None
    assert record_agrees(signals, time, outcome | {"switch_success": None}) is None  # not judged
    void = {"switch_success": None, "void": True}
    assert record_agrees(signals, time, outcome | void) == "by the requirements false switch, by the scoring None"
    assert record_agrees(signals, time, outcome | void | {"false_switches": None}) is None  # a fault that never came


def test_rtamt_is_there_where_its_parser_is():
    """So that the slice is not skipped for ever."""
    assert rtamt is not None or sys.version_info >= (3, 13)
