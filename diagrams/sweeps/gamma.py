"""Switching success against gamma."""

from __future__ import annotations

import numpy as np
import pandas as pd

from diagrams.sweeps.summary import cells, controller_name


def gamma_curves(rows: pd.DataFrame) -> tuple[dict[str, list], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Success of each controller and disturbance at each gamma, and its upper bound from the runs at the largest gamma.

    A run is the same under each gamma until an error first reaches it. So the runs at the largest gamma say for every
    smaller one whether there would have been a false alarm and whether the disturbance would have been noticed; not
    whether the return and the resumption would have gone well, which takes other runs.

    Args:
        rows: a table of sweeps (see table.py).

    Returns:
        curves: by a label, points with gamma and the entries of summary.rate; none for a controller with one gamma.
        bounds: by a label, gammas (200,) and the share (200,) of runs with no false alarm and, if disturbed, noticed.
    """
    swept = rows[rows["gamma"].notna()]
    curves: dict[str, list] = {}
    for cell in sorted(cells(swept), key=lambda cell: cell["gamma"]):
        kind = cell["disturbance"]
        label = f"{controller_name(cell | {'gamma': None})}, {'no disturbance' if kind == 'none' else kind}"
        names = {name: cell[name] for name in ("rnn", "detector", "disturbance", "gamma")}
        curves.setdefault(label, []).append(names | cell["switching"])
    curves = {label: points for label, points in curves.items() if len(points) > 1}
    bounds = {}
    for label, points in curves.items():
        last = points[-1]
        same = np.logical_and.reduce(
            [swept[name] == last[name] for name in ("rnn", "detector", "disturbance", "gamma")]
        )
        gammas = np.geomspace(points[0]["gamma"], last["gamma"], 200)
        good = swept[same]["error_peak_normal"].to_numpy(float)[:, None] < gammas
        if last["disturbance"] != "none":
            good &= swept[same]["error_peak_disturbed"].to_numpy(float)[:, None] >= gammas
        bounds[label] = (gammas, good.mean(axis=0))
    return curves, bounds
