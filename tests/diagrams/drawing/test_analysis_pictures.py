"""The pictures of the analyses, from numbers made by hand: their words, and what is drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.drawing import automaton, defeat, falsification, guard, return_certificate, spectra
from diagrams.episodes.episode import Episode
from diagrams.world.disturbance import DisturbanceSpec


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """Draws into a file; returns its words and the figure."""

    def draw(module, function, *arguments):
        figures, save = [], module.save
        monkeypatch.setattr(module, "save", lambda figure, path: figures.append(figure) or save(figure, path))
        path = tmp_path / "new" / "picture.svg"
        getattr(module, function)(*arguments, path)
        return path.read_text(), figures[0].axes

    return draw


def test_automaton(drawn):
    stays = [
        {"mode": "task", "start": 0.0, "end": 3.0, "complete": False},
        {"mode": "return", "start": 3.0, "end": 5.0, "complete": True},
    ]
    report = {
        "runs": 2, "max_crossings_per_second": 1, "transitions": {"task->return": 7, "return->task": 6},
        "dwell_seconds": {"task": {"count": 0}, "return": {"count": 4, "min": 1.0, "median": 2.0, "max": 3.5}},
        "sequences": [{"name": "first", "outcome": "done", "modes": stays},
                      {"name": "second", "outcome": "time", "modes": stays[:1]}],
    }  # fmt: skip
    words, (_, right) = drawn(automaton, "save_automaton", report)
    for word in ("7 times: recall fails", "6 times: recalls again", "1.0 / 2.0 / 3.5 s", "stays: 4", "second (time)"):
        assert word in words
    bars = [(bar.get_x(), bar.get_width(), bar.get_y() + bar.get_height() / 2) for bar in right.patches]
    assert np.array(bars) == pytest.approx(np.array([(0.0, 3.0, 0), (3.0, 2.0, 0), (0.0, 3.0, 1)]))


def test_spectra(drawn):
    eigenvalues, norms = [[1.05, 0.0], [0.0, 0.5]], 1e-5 * 1.05 ** np.arange(60)
    words, (left, right) = drawn(spectra, "save_spectra", [("lstm, subtask 1", eigenvalues, [norms, norms[:50]])])
    assert "lstm, subtask 1: spectral radius 1.0500" in words
    assert left.lines[-1].get_xydata().tolist() == [[1.05, 0.0]]  # what is outside of the circle is marked
    assert right.lines[-1].get_ydata() == pytest.approx(norms[30:])  # predicted


def test_guard(drawn):
    x = np.linspace(-10, 10, 5)
    errors = np.hypot(*np.meshgrid(x, x)) + 0.1
    errors[0, 0] = np.nan
    report = {
        "coordinates_deg": x.tolist(), "errors": errors.tolist(),
        "alpha": np.where(errors > 6, 1.0, errors * 0).tolist(),
        "gamma": 6.0, "bisected_points_deg": [[6.0, 0.0]], "joints": (1, 4),
    }  # fmt: skip
    words, axes = drawn(guard, "save_guard", report, "the title")
    for word in ("the title", "displacement of joint 4 (deg)", "task", "return"):
        assert f"<!-- {word} -->" in words
    names = {text.get_text(): text.get_position() for text in axes[0].texts}
    assert names["task"] == (0.0, 0.0)
    report["bisected_points_deg"] = []
    assert "bisection" not in drawn(guard, "save_guard", report, "the title")[0]


def test_falsification(drawn):
    def trial(objective, failure, moved):
        return {"objective": objective, "failure": failure, "moved_deg": moved, "length_ticks": 9}

    trials = {"tpe": [trial(1.5, None, 4.0), trial(0.4, "not returned", 20.0), trial(1.2, None, 5.0)], "random": []}
    words, (left, right) = drawn(falsification, "save_search", trials)
    for word in ("withstood (2)", "not returned (1)", "not resumed (0)", "switched again (0)", "tpe", "random"):
        assert word in words
    assert left.lines[0].get_ydata().tolist() == [1.5, 0.4, 0.4]
    assert right.lines[0].get_xydata().tolist() == [[4.0, 9.0], [5.0, 9.0]]


def test_certificate(drawn):
    falls = 0.9 ** np.arange(60)
    data = {
        "values": {"box": [np.array([1.0, 0.8, 0.5]), np.array([0.9, 0.6])], "onsets": [], "targets": [falls[5:]]},
        "levels": {"box": np.array([1.0, 0.9]), "onsets": np.zeros(0), "targets": np.array([0.3, 0.3, 1.2, 0.59])},
        "promises": {"box": falls, "onsets": 0.5 ** np.arange(60), "targets": 0.5 ** np.arange(60)},
        "at_home": 0.1, "period": 0.1,
    }  # fmt: skip
    words, (left, middle, right) = drawn(return_certificate, "save_certificate", data)
    for word in ("uniform in the box: median and range of 2", "targets of disturbance A (4)", "border of the box"):
        assert word in words
    assert left.lines[0].get_ydata() == pytest.approx([0.95, 0.7, 0.55])  # the median; a way that ended stays
    assert left.lines[1].get_ydata()[:3] == pytest.approx([1.0, 0.9, 0.81])  # certified
    assert middle.lines[0].get_ydata() == pytest.approx(falls[5:])
    assert middle.lines[1].get_ydata()[:3] == pytest.approx([1.0, 0.5, 0.25])
    assert right.get_xlim()[1] > 1.2  # one that lies outside is seen


def test_defeat(drawn):
    def case(kind, level, subtask, hold, moved):
        given = DisturbanceSpec(kind, 0.05 + 0.01 * hold / 5, None, hold, subtask)
        return SimpleNamespace(episode=Episode(0, (0.5, 0.0), "left", given), level=level, moved_deg=moved)

    def entry(kind, brute):
        stages = [{"level": 0.4, "share": 0.3}, {"level": 0.7, "share": 0.3}]
        runs = [{"estimate": 0.01, "stages": stages}, {"estimate": 0.0, "stages": stages}]
        cases = [case(kind, 1.0, 2, 20, 60.0), case(kind, 0.5, 1, 15, 40.0), case(kind, 1.0, 2, 25, 70.0)]
        above = [{"level": 0.4, "brute": brute and {"interval": [0.2, 0.4]}}]
        return {"report": {"repetitions": runs, "brute": brute, "above": above}, "cases": cases}

    found = {"A": entry("A", None), "B": entry("B", {"interval": [0.0, 0.05]})}
    words, (climb, moves, stops) = drawn(defeat, "save_defeat", found)
    for word in ("defeated, subtask 2 (2)", "withstood, subtask 1 (1)", "disturbance A", "stop (ticks)"):
        assert f"<!-- {word} -->" in words
    assert climb.lines[0].get_xydata() == pytest.approx(np.array([[0.4, 0.3], [0.7, 0.09], [1.0, 0.01]]))
    assert len(climb.lines[1].get_xydata()) == 2  # an extinct one ends where it ended
    bars = [line.get_xydata() for line in climb.lines[4:]]  # of brute force, beyond a level and of a defeat
    assert bars == [
        pytest.approx(np.array([[0.4, 0.2], [0.4, 0.4]])),
        pytest.approx(np.array([[1.06, 1e-6], [1.06, 0.05]])),
    ]
    assert moves.lines[-1].get_xydata() == pytest.approx(np.array([[9.0, 60.0], [10.0, 70.0]]))
    assert stops.lines[-1].get_ydata() == pytest.approx([20.0, 25.0])
