"""The diagram as a graph."""

import cv2
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder

from diagrams.drawing.graph import save_graph
from diagrams.hybrid.states import States
from models.errors import InputError

SYSTEMS = (
    "switched_controller", "station", "disturbance", "image_encoder", "recurrent_policy", "posture_history",
    "loop_closer", "detector", "alpha_hold", "errors_hold", "regulated_mixer", "plant", "approach_meter",
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
    height, width, _ = cv2.imread(str(tmp_path / "graph.png")).shape
    assert width > height > 300  # landscape


def test_the_dependency_draws_where_there_is_no_graphviz(rollout, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    save_graph(rollout.diagram, tmp_path / "graph.svg")
    assert "switched_controller" in (tmp_path / "graph.svg").read_text()


def test_unknown_format_of_the_graph(rollout, tmp_path):
    with pytest.raises(InputError, match=r"graph\.gif is no format for the graph: .*\.dot, \.svg, \.png"):
        save_graph(rollout.diagram, tmp_path / "graph.gif")


def small_diagram():
    builder = DiagramBuilder()
    adder = builder.AddNamedSystem("adder", Adder(1, 1))
    builder.ExportInput(adder.get_input_port(0))
    return builder.Build()


def test_no_program_to_draw_with(tmp_path, monkeypatch):
    diagram = small_diagram()
    monkeypatch.setattr("diagrams.drawing.graph.shutil.which", lambda *arguments, **keywords: None)
    with pytest.raises(InputError, match="no program `dot`"):
        save_graph(diagram, tmp_path / "graph.svg")
    save_graph(diagram, tmp_path / "graph.dot")  # needs none
    with pytest.raises(InputError, match="no program `dot`"):
        States(out=tmp_path / "states").run()  # before its work
    assert not (tmp_path / "states").exists()


@pytest.mark.parametrize("script", ["#!/bin/sh\necho 'no such\nfont' >&2; exit 3\n", "no program at all"])
def test_a_program_that_fails_is_bad_input_and_no_traceback(tmp_path, monkeypatch, script):
    dot = tmp_path / "dot"
    dot.write_text(script)
    dot.chmod(0o755)
    monkeypatch.setattr("diagrams.drawing.graph.shutil.which", lambda *arguments, **keywords: str(dot))
    with pytest.raises(InputError, match=r"dot cannot draw .*graph.svg \((no such font|.*rror.*)\): mend"):
        save_graph(small_diagram(), tmp_path / "graph.svg")
