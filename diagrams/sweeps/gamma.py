"""Switching success against gamma."""

import numpy as np
import pandas as pd

from diagrams.sweeps.summary import CELL, cells, controller_name, disturbance_name


def gamma_curves(rows: pd.DataFrame) -> tuple[dict[str, list], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Success of each controller and disturbance at each gamma, and its upper bound from the runs at the largest gamma.

    A run is the same under each gamma until an error first reaches it. So the runs at the largest gamma say for every
    smaller one whether there would have been a false alarm and whether the disturbance would have been noticed; not
    whether the return and the resumption would have gone well, which takes other runs.

    `rows`: a table of sweeps (see table.py). Returns, by a label for each controller with several gammas, the points
    with gamma and the entries of summary.rate; and the bounds, gammas (200,) and the share (200,) of runs with no false
    alarm and, if disturbed, noticed.
    """
    swept = rows[rows["gamma"].notna()]
    curves: dict[str, list] = {}
    for cell in sorted(cells(swept), key=lambda cell: cell["gamma"]):
        if not cell["switching"]["n"]:  # each was void
            continue
        kind = disturbance_name(cell)
        label = f"{controller_name(cell | {'gamma': None})}, {'no disturbance' if kind == 'none' else kind}"
        curves.setdefault(label, []).append({name: cell[name] for name in CELL} | cell["switching"])
    curves = {label: points for label, points in curves.items() if len(points) > 1}
    bounds = {}
    for label, points in curves.items():
        last = points[-1]
        labels = {name: last[name] for name in CELL if name in swept}
        same = [swept[name].isna() if value is None else swept[name] == value for name, value in labels.items()]
        runs = swept[np.logical_and.reduce(same)]
        gammas = np.geomspace(points[0]["gamma"], last["gamma"], 200)
        runs = runs[runs["switch_success"].notna()]
        good = runs["error_peak_normal"].to_numpy(float)[:, None] < gammas
        if last["disturbance"] != "none":
            good &= runs["error_peak_disturbed"].to_numpy(float)[:, None] >= gammas
        bounds[label] = (gammas, good.mean(axis=0))
    return curves, bounds
