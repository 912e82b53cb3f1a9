"""The curve of gamma and its bound from the runs at the largest."""

import numpy as np
import pandas as pd
import pytest

from diagrams.sweeps.gamma import gamma_curves
from tests.diagrams.sweeps.rows import frame


def with_peaks(rows, normal, disturbed):
    return rows.assign(error_peak_normal=normal, error_peak_disturbed=disturbed)


def test_gamma_curves_and_their_bounds():
    rows = pd.concat(
        [
            with_peaks(frame("lstm", [1, 1, 0, 0], gamma=10.0), np.nan, np.nan),
            with_peaks(frame("lstm", [1, 0, 0, 0], gamma=1e3), [5.0, 5.0, 50.0, 5.0], [2e3, 400.0, 400.0, 8.0]),
            with_peaks(frame("lstm", [1, 1, 1, 1], gamma=10.0, disturbance="none"), np.nan, np.nan),
            with_peaks(frame("lstm", [1, 1, 1, 1]), np.nan, np.nan),
        ]
    )
    curves, bounds = gamma_curves(rows)
    assert list(curves) == list(bounds) == ["LSTM recall, A"]  # one point alone is no curve
    assert [(p["gamma"], p["rate"]) for p in curves["LSTM recall, A"]] == [(10.0, 0.5), (1000.0, 0.25)]
    gammas, share = bounds["LSTM recall, A"]
    assert (gammas[0], gammas[-1]) == pytest.approx((10.0, 1000.0))
    # At 10: the third run is a false alarm, the fourth is not noticed; at 100 the third is fine; at 1000 only the first
    # is noticed.
    assert np.interp([10.0, 100.0, 1000.0], gammas, share) == pytest.approx([0.5, 0.75, 0.25])
    assert gamma_curves(rows[rows["gamma"].isna()]) == ({}, {})


def test_without_a_disturbance_a_false_alarm_alone_counts():
    rows = pd.concat(
        [
            with_peaks(frame("gru", [0, 0], gamma=1.0, disturbance="none"), np.nan, np.nan),
            with_peaks(frame("gru", [1, 1], gamma=100.0, disturbance="none"), [5.0, 50.0], np.nan),
        ]
    )
    curves, bounds = gamma_curves(rows)
    gammas, share = bounds["GRU recall, no disturbance"]
    assert len(curves) == 1
    assert np.interp([1.0, 10.0, 100.0], gammas, share) == pytest.approx([0.0, 0.5, 1.0])
