"""DwellTime: hand-worked numbers, in float and AutoDiffXd; how often the guard can be crossed."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from systems.dwell_time import DwellTime
from tests.systems.system_checks import evaluate, evaluate_autodiff

DWELL = DwellTime(history=4, dwell_ticks=2)


@pytest.mark.parametrize(
    ("last", "alpha"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.8),
        ([1.0, 0.0, 0.0, 0.0], 0.8),  # it stays up
        ([0.2, 0.5, 0.0, 0.0], 0.0),  # it fell at the tick before
        ([0.0, 0.2, 1.0, 0.0], 0.0),  # two ticks before
        ([0.0, 0.0, 0.2, 1.0], 0.8),  # three: the dwell time is over
        ([0.6, 0.2, 1.0, 0.0], 0.0),
    ],
)
def test_dwell_time_by_hand(last, alpha):
    inputs = dict(detector_alpha=[0.8], last_alphas=last)
    assert evaluate(DWELL, "alpha", inputs) == pytest.approx([alpha])
    value, gradient = evaluate_autodiff(DWELL, "alpha", inputs, "detector_alpha")
    assert value == pytest.approx([alpha])
    assert gradient.ravel() == pytest.approx([1.0 if alpha else 0.0])


def test_no_dwell_time_is_transparent():
    gate = DwellTime(history=1, dwell_ticks=0)
    assert evaluate(gate, "alpha", dict(detector_alpha=[0.8], last_alphas=[0.0])) == pytest.approx([0.8])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60), st.integers(0, 3))
def test_dwell_time_bounds_the_crossings(detector_alphas, ticks):
    """Whatever the detector says, a stay below the guard lasts W + 1 ticks at least."""
    gate, past = DwellTime(history=4, dwell_ticks=ticks), [0.0] * 4
    for alpha in detector_alphas:
        past.insert(0, float(evaluate(gate, "alpha", dict(detector_alpha=[alpha], last_alphas=past[:4]))[0]))
    high = "".join("1" if alpha >= 0.5 else "0" for alpha in reversed(past))
    assert all(len(stay) > ticks for stay in high.split("1")[1:-1] if stay)
