"""What the analysis' pictures share: figures without a display, colours, one way of saving."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BLUE, RED, GREEN, ORANGE = "#2b6cb0", "#c53030", "#2f855a", "#dd8a20"


def new_figure(rows: int = 1, columns: int = 1, **keywords: Any) -> tuple[Any, Any]:
    """A figure and its axes that need no display; keywords as of matplotlib's `subplots`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, layout="constrained", **keywords)


def save(figure: Any, path: Path) -> None:
    """Writes `figure` to `path` and frees it."""
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
