"""What all pictures share: figures without a display, colours, one way of saving."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, RED, GREEN, ORANGE = "#2b6cb0", "#c53030", "#2f855a", "#dd8a20"
DPI = 110
_OF_FIGURE = ("figsize", "dpi", "facecolor", "edgecolor")


def new_figure(rows: int = 1, columns: int = 1, **keywords: Any) -> tuple[Figure, Any]:
    """A figure and its axes; keywords as of matplotlib's `pyplot.subplots`.

    Without pyplot: what is set from outside as its backend (MPLBACKEND) plays no part.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    of_figure = {name: keywords.pop(name) for name in _OF_FIGURE if name in keywords}
    figure = Figure(layout="constrained", **of_figure)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **keywords)


def save(figure: Figure, path: Path) -> None:
    """Writes `figure` to `path`, in the format that its ending says; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)
