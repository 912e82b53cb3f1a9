"""The delay margin: the closed form against eigenvalues, and the loop whose step comes late."""

import numpy as np
import pytest

from diagrams.hybrid import delay_margin as module
from diagrams.hybrid.delay_margin import AMPLITUDE, DelayedLoop, delay_margin, measured_delay_margin, swings_die_out


def spectral_radius(gain, delay):
    """Of d[k+1] = d[k] - gain d[k - delay], from its companion matrix."""
    companion = np.eye(delay + 1, k=-1)
    companion[0, 0] += 1.0
    companion[0, -1] -= gain
    return np.abs(np.linalg.eigvals(companion)).max()


@pytest.mark.parametrize("gain", [0.03, 0.1, 0.25, 0.6, 0.99, 1.5])
def test_closed_form_is_where_the_eigenvalues_leave_the_circle(gain):
    delay = delay_margin(gain)
    assert spectral_radius(gain, delay) < 1.0
    assert spectral_radius(gain, delay + 1) > 1.0


def test_margins_by_hand():
    assert delay_margin(0.1) == 15
    # One tick late: z^2 - z + k leaves the circle at k = 1; not late at all: at k = 2.
    assert (delay_margin(0.999), delay_margin(1.001), delay_margin(1.999)) == (1, 0, 0)


def test_the_step_comes_late(world):
    deviation = AMPLITUDE * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    rows = DelayedLoop(world, 3).run(deviation, 8)
    assert rows.shape == (9, 7)
    assert rows[0] == pytest.approx(deviation)
    # Four ticks long the step is that of the start, 0.1 of it, of which the servo executes nine tenths at least; the
    # first one begins to move the arm from rest.
    steps = np.diff(rows, axis=0) / deviation
    assert steps[1:4] == pytest.approx(-0.1, abs=0.015)
    assert np.all(np.diff(steps[3:], axis=0) > 0.0)  # then it grows smaller
    assert not swings_die_out(np.array([[1.0], [1.0], [1.1], [1.0], [0.9], [1.0], [0.8], [1.2]]))
    assert swings_die_out(np.array([[1.0], [1.0], [1.1], [1.0], [0.9], [1.0], [0.8], [1.0]]))


@pytest.mark.parametrize(("expected", "true", "found"), [(15, 16, 16), (15, 13, 13), (15, 0, 0), (15, 15, 15)])
def test_the_measured_margin_is_looked_for_both_ways(monkeypatch, expected, true, found):
    class Loop:
        def __init__(self, world, delay):
            self.delay = delay

        def run(self, start, ticks):
            rate = 0.9 if self.delay <= true else 1.1
            return np.outer(rate ** np.arange(20), start)

    monkeypatch.setattr(module, "DelayedLoop", Loop)
    assert measured_delay_margin(None, expected) == found
