"""The paper's figures: what is drawn, read back from the figure that is saved."""

import numpy as np
import pytest

from diagrams.drawing import paper_figures
from diagrams.drawing.paper_figures import save_gamma_curve, save_recall_loss, save_reconstructions, save_states


@pytest.fixture
def saved(monkeypatch):
    """The figures that are saved."""
    figures = []
    monkeypatch.setattr(paper_figures, "save", lambda figure, path: figures.append(figure))
    return figures


def test_recall_loss_is_mean_and_span_of_the_seeds(saved):
    save_recall_loss({"lstm": np.array([[1.0, 2.0], [3.0, 6.0]]), "gru": np.ones((1, 2))}, None)
    axis = saved[0].axes[0]
    lstm, gru = axis.get_lines()
    assert (lstm.get_label(), gru.get_label()) == ("LSTM (2 training seeds)", "GRU (1 training seed)")
    assert lstm.get_xydata().tolist() == [[1, 2.0], [2, 4.0]]
    vertices = axis.collections[0].get_paths()[0].vertices
    assert {tuple(v) for v in vertices} == {(1, 1.0), (1, 3.0), (2, 2.0), (2, 6.0)}


def test_reconstructions_are_a_column_an_event(saved):
    pictures = [np.full((112, 112, 3), grey, np.uint8) for grey in range(6)]
    save_reconstructions([(0.0, "begins", pictures[:3]), (4.0, "is disturbed", pictures[3:])], None)
    axes = np.array(saved[0].axes).reshape(3, 2)
    assert [[axis.images[0].get_array()[5, 5, 0] for axis in row] for row in axes] == [[0, 3], [1, 4], [2, 5]]
    assert [axis.get_title() for axis in axes[0]] == ["begins\n0.0 s", "is disturbed\n4.0 s"]


def test_states_are_parted_by_subtask_and_by_who_leads(saved):
    states = np.arange(12.0).reshape(4, 3)
    subtask, alpha = np.array([1, 1, 2, 2]), np.array([0.0, 1.0, 0.0, 0.0])
    save_states({"run": (states, subtask, alpha)}, np.array([7.0, 8.0, 9.0]), np.array([0.5, 0.25, 0.125]), None)
    first, second = saved[0].axes
    drawn = {line.get_label(): line.get_xydata() for line in second.get_lines()}
    finite = {label: xy[np.isfinite(xy).all(axis=1)].tolist() for label, xy in drawn.items()}
    assert finite == {
        "subtask 1": [[0.0, 2.0]],
        "subtask 2": [[6.0, 8.0], [9.0, 11.0]],
        r"$\alpha \geq 0.5$: on its own predictions": [[3.0, 5.0]],
        "switching point": [[7.0, 9.0]],
    }
    assert (first.get_xlabel(), second.get_ylabel()) == ("PC1 (50.0 %)", "PC3 (12.5 %)")


def test_gamma_curve_is_in_percent_with_its_bound(saved):
    points = [
        {"gamma": 3.0, "rate": 0.5, "interval": [0.25, 0.75]},
        {"gamma": 30.0, "rate": 1.0, "interval": [0.8, 1.0]},
    ]
    save_gamma_curve(
        {"LSTM recall, A": points}, {"LSTM recall, A": (np.array([3.0, 30.0]), np.array([0.6, 1.0]))}, None
    )
    axis = saved[0].axes[0]
    curve, bound = axis.get_lines()[:2]
    assert curve.get_xydata().tolist() == [[3.0, 50.0], [30.0, 100.0]]
    assert bound.get_xydata().tolist() == [[3.0, 60.0], [30.0, 100.0]]
    assert (3.0, 75.0) in {tuple(v) for v in axis.collections[0].get_paths()[0].vertices}
    assert [label.get_text() for label in axis.get_xticklabels()] == ["3", "30"]
