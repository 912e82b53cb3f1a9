"""What all pictures share: figures without a display, colours, one way of saving."""

import os
from pathlib import Path
from typing import Any

# Importing matplotlib looks for the backend that a notebook may have left here; no picture of ours needs one.
os.environ.pop("MPLBACKEND", None)

from matplotlib.axes import Axes  # noqa: F401 (for those who draw)
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from models.files.container import whole_file

BLUE, RED, GREEN, ORANGE = "#2b6cb0", "#c53030", "#2f855a", "#dd8a20"
DPI = 110


def new_figure(
    rows: int = 1, columns: int = 1, figsize: tuple[float, float] | None = None, **keywords: Any
) -> tuple[Figure, Any]:
    """A figure of `figsize` (inches) and its axes; keywords as of matplotlib's `Figure.subplots`.

    Without pyplot: what is set from outside as its backend (MPLBACKEND) plays no part.
    """
    figure = Figure(figsize, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **keywords)


def save(figure: Figure, path: Path) -> None:
    """Writes `figure` to `path`, in the format that its ending says; makes the folder."""
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=DPI)
