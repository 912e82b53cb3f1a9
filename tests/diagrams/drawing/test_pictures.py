"""The diagram as a graph, the run as a timeline."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder

from diagrams.drawing.graph import save_graph
from diagrams.drawing.timeline import save_timeline
from diagrams.episodes.record import Record
from models.errors import InputError

PNG = b"\x89PNG\r\n\x1a\n"
SYSTEMS = (
    "switched_controller", "station", "disturbance", "image_encoder", "recurrent_policy", "posture_history",
    "loop_closer", "detector", "dwell_time", "regulated_mixer", "plant", "approach_meter",
)  # fmt: skip


def test_graph_as_text_names_the_systems(rollout, tmp_path):
    path = tmp_path / "new" / "graph.dot"
    save_graph(rollout.diagram, path)
    text = path.read_text()
    assert text.startswith("digraph")
    for name in SYSTEMS:
        assert name in text


def test_graph_as_picture(rollout, tmp_path):
    save_graph(rollout.diagram, tmp_path / "graph.svg")
    text = (tmp_path / "graph.svg").read_text()
    assert "<svg" in text
    for name in SYSTEMS:
        assert name in text
    save_graph(rollout.diagram, tmp_path / "graph.png")
    assert (tmp_path / "graph.png").read_bytes().startswith(PNG)


def test_the_dependency_draws_where_there_is_no_graphviz(rollout, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    save_graph(rollout.diagram, tmp_path / "graph.svg")
    assert "switched_controller" in (tmp_path / "graph.svg").read_text()


def test_unknown_format_of_the_graph(rollout, tmp_path):
    with pytest.raises(InputError, match=r"graph\.gif is no format for the graph: .*\.dot, \.svg, \.png"):
        save_graph(rollout.diagram, tmp_path / "graph.gif")


def test_no_program_to_draw_with(tmp_path, monkeypatch):
    builder = DiagramBuilder()
    builder.AddNamedSystem("adder", Adder(1, 1))
    builder.ExportInput(builder.GetSystems()[0].get_input_port(0))
    diagram = builder.Build()
    monkeypatch.setattr("diagrams.drawing.graph.shutil.which", lambda *arguments, **keywords: None)
    with pytest.raises(InputError, match="no program `dot`"):
        save_graph(diagram, tmp_path / "graph.svg")
    save_graph(diagram, tmp_path / "graph.dot")  # needs none


def record(n=120):
    ticks = np.arange(n)
    alpha = np.where((ticks > 40) & (ticks < 90), 1.0, 0.0)
    rng = np.random.default_rng(0)
    return Record(
        time=0.1 * ticks, posture=np.cumsum(rng.normal(size=(n, 8)), axis=0) * 0.01,
        rnn_step=0.01 * rng.normal(size=(n, 8)), regulator_step=0.01 * rng.normal(size=(n, 8)),
        desired_posture=np.zeros((n, 8)), alpha=alpha, errors=np.ones((n, 11)), hidden_state=np.zeros((n, 4)),
        features=np.zeros((n, 3)), active=(ticks > 38) & (ticks < 50), can_poses=np.zeros((n, 14)),
        squared_errors=np.zeros((n, 11)),
        events=[(0.0, "subtask 1: pick the can"), (3.9, "the experimenter disturbs the arm"), (4.1, "recall fails: switched to the LQR")],
    )  # fmt: skip


def test_timeline_is_drawn(tmp_path):
    save_timeline(record(), tmp_path / "new" / "timeline.png", "title")
    assert (tmp_path / "new" / "timeline.png").read_bytes().startswith(PNG)


def test_timeline_shows_its_parts(tmp_path):
    save_timeline(record(), tmp_path / "timeline.svg", "the title of it")
    text = (tmp_path / "timeline.svg").read_text()
    for comment in ("the title of it", "time (s)", "joint 7", "the experimenter disturbs the arm"):
        assert comment in text
    assert "subtask 1" not in text  # only what is labelled
