"""A run over time: what is drawn, read back from the figure that is saved."""

import numpy as np
import pytest

from diagrams.drawing import timeline
from diagrams.drawing.timeline import save_sequences, save_timeline
from tests.diagrams.recorded_run import recorded_run


@pytest.fixture
def saved(monkeypatch):
    """The figures that are saved."""
    figures = []
    monkeypatch.setattr(timeline, "save", lambda figure, path: figures.append(figure))
    return figures


def curves(axis):
    return {line.get_label(): line.get_ydata() for line in axis.get_lines() if line.get_label()[0] != "_"}


def spans(axis):
    """First and last second of what is shaded, orange before red."""
    return [
        (round(x.min(), 6), round(x.max(), 6))
        for collection in axis.collections
        for x in [np.concatenate([path.vertices[:, 0] for path in collection.get_paths()])]
    ]


def test_timeline_shows_the_run(saved):
    record = recorded_run()
    save_timeline(record, None, "title")
    axes = saved[0].axes
    assert curves(axes[0])["joint 3"] == pytest.approx(np.rad2deg(record.posture[:, 2]))
    assert curves(axes[1])["joint 7"] == pytest.approx(np.rad2deg(record.rnn_step[:, 6]))
    assert curves(axes[2])["joint 1"] == pytest.approx(np.rad2deg(record.regulator_step[:, 0]))
    assert axes[4].get_lines()[0].get_ydata().tolist() == record.alpha.tolist()
    assert axes[5].get_lines()[0].get_ydata() == pytest.approx(1000 * record.posture[:, 7])
    for axis in axes[:5]:
        assert spans(axis) == [(3.9, 4.9), (4.1, 8.9)]  # disturbed; alpha >= 0.5
    # What is labelled alone, the second label above the first.
    texts = {text.get_text(): text.get_position() for text in axes[0].texts}
    assert texts == {
        "the experimenter disturbs the arm": (3.9, pytest.approx(1.02)),
        "recall fails: switched to the LQR": (4.1, pytest.approx(1.09)),
    }


def test_text_is_in_the_picture(tmp_path):
    save_timeline(recorded_run(), tmp_path / "new" / "timeline.svg", "the title of it")
    text = (tmp_path / "new" / "timeline.svg").read_text()
    for comment in ("the title of it", "time (s)", "joint 7", "the experimenter disturbs the arm"):
        assert comment in text
    assert "subtask 1" not in text


def test_sequences_are_a_column_a_run(saved):
    runs = {"no disturbance": recorded_run(), "disturbance A": recorded_run(80, seed=1)}
    save_sequences(runs, None)
    axes = np.array(saved[0].axes).reshape(4, 2)
    for column, (title, record) in zip(axes.T, runs.items(), strict=True):
        assert column[0].get_title() == title
        assert curves(column[0])["joint 2"] == pytest.approx(np.rad2deg(record.posture[:, 1]))
        assert column[3].get_lines()[0].get_ydata().tolist() == record.alpha.tolist()
        assert spans(column[2])[0] == (3.9, 4.9)
    assert [axis.get_ylabel() for axis in axes[:, 0]] == [
        "$m$ (deg)",
        r"$\Delta m^R$ (deg)",
        r"$\Delta m^L$ (deg)",
        r"$\alpha$",
    ]
    assert saved[0].legends[0].get_texts()[6].get_text() == "joint 7"
