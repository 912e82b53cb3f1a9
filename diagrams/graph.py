"""The diagram as a picture."""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from pathlib import Path

from pydrake.systems.framework import Diagram

from diagrams.scenario import ScenarioError

FORMATS = (".dot", ".svg", ".png")
# The controller and the station's own systems are shown; what is inside Drake's is not.
DEPTH = 2


def save_graph(diagram: Diagram, path: Path) -> None:
    """Writes the graph of `diagram`, left to right, as .dot, .svg or .png; raises ScenarioError for another format or without `dot`."""
    if path.suffix not in FORMATS:
        raise ScenarioError(f"{path.name} is no format for the graph: choose a name that ends in {', '.join(FORMATS)}")
    text = diagram.GetGraphvizString(max_depth=DEPTH, options={"plant/split": "I/O"})
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".dot":
        path.write_text(text)
        return
    # The dependency's command, beside this Python, where there is no Graphviz.
    dot = shutil.which("dot") or shutil.which("graphviz-pure", path=sysconfig.get_path("scripts"))
    if dot is None:
        raise ScenarioError(
            "there is no program `dot` to draw the graph with: install Graphviz or the package graphviz-pure, or ask for .dot"
        )
    subprocess.run(
        [dot, f"-T{path.suffix[1:]}", "-o", str(path)], input=text, text=True, check=True, capture_output=True
    )
