"""The picture of what the calibration promises, from numbers made by hand: what is drawn where."""

import numpy as np
import pytest

from diagrams.drawing import coverage
from diagrams.monitors.promise import Threshold, resampled


def test_false_alarms_coverage_and_band(tmp_path, monkeypatch):
    figures, save = [], coverage.save
    monkeypatch.setattr(coverage, "save", lambda figure, path: figures.append(figure) or save(figure, path))
    calibration, fresh, cells = np.arange(9.0), np.array([1.0, 2.0, 8.5, 9.5]), []
    orders = [np.random.default_rng(i).permutation(13) for i in range(30)]
    for name, factor in (("recall", 1.0), ("speed", 2.0)):
        for delta in (0.2, 0.4):
            judged = Threshold.of(calibration, delta).judged(factor * fresh)
            split = resampled(np.concatenate((calibration, fresh)), 9, delta, orders)
            cells.append({"detector": name, "delta": delta, "constant": judged, "band": judged, "resampled": split})
    phase = np.stack((np.repeat((0, 1), 4), np.tile(np.arange(4), 2)), axis=1)
    example = {
        "label": "recall", "mean": (np.zeros(3), np.ones(2)), "scale": (np.ones(3), 2.0 * np.ones(2)),
        "gammas": [3.0, 2.0], "constant": [7.0, 5.0], "curves": [(phase, np.arange(8.0))],
    }  # fmt: skip
    path = tmp_path / "new" / "coverage.svg"
    coverage.save_coverage({"cells": cells}, example, path)
    assert {word for word in ("recall", "speed", "beta-binomial", "constant", "band") if word in path.read_text()} == {
        "recall", "speed", "beta-binomial", "constant", "band",
    }  # fmt: skip
    axes = np.array(figures[0].axes).reshape(3, 2)
    constant = axes[0, 0].containers[0].lines[0]  # of either: two of four are above 7
    assert constant.get_xdata().tolist() == [0.5, 0.5]
    # What is drawn of the law adds up to all there is, and so do the splits.
    for column in (0, 1):
        shapes = [patch.get_data() for patch in axes[1, column].patches if hasattr(patch, "get_data")]
        for shape in shapes:
            assert shape.values.sum() == pytest.approx(1.0, abs=1e-2)
            assert -0.5 < shape.edges[0] <= 0.0  # no share is below 0
    # The band is mean + gamma scale; longer runs stay in the last phase; subtask 2 stands behind 1.
    bands = [line for line in axes[2, 0].lines if line.get_linestyle() == "-" and len(line.get_xdata()) in (2, 3)]
    uppers = {tuple(np.round(line.get_ydata(), 9)) for line in bands}
    assert {(3.0, 3.0, 3.0), (7.0, 7.0)} <= uppers
    points = [line.get_xdata().tolist() for line in axes[2, 0].lines[:2]]
    start = 3 + coverage.GAP
    assert points == [[0, 1, 2, 2], [start, start + 1, start + 1, start + 1]]
