"""What is promised of V: hand-worked rates, bounds and times."""

import numpy as np
import pytest

from diagrams.hybrid.return_promise import Promise, contractions
from models.errors import InputError

WAYS = [np.array([1.0, 0.95, 0.874, 0.01, 0.0099]), np.array([0.5, 0.45, 0.40995])]


def test_contractions_by_hand():
    first, later = contractions(WAYS[0], 0.011)
    assert first == pytest.approx([0.95])
    assert later == pytest.approx([0.92, 0.01 / 0.874])  # at home nothing is promised
    first, later = contractions(np.array([0.01, 0.01]), 0.011)
    assert len(first) == len(later) == 0


def test_rates_by_hand():
    apart = Promise.measured(WAYS, [0.9, 0.9], 0.9, 0.95, 0.011, apart=True)
    # Half as much again as the excess of 0.02; with the first ticks, of 0.05.
    assert (apart.later, apart.calibrated) == (pytest.approx(0.93), 2)
    assert np.array_equal(apart.first(np.array([0.9, 0.91])), [1.0, 1.0])
    assert apart.slowest == 1.0
    together = Promise.measured(WAYS, [0.9, 0.9], 0.9, 0.92, 0.011, apart=False)
    assert together.later == pytest.approx(0.975)
    assert together.first(np.array([0.9, 0.91, 0.95])) == pytest.approx([0.975, 0.985, 1.0])
    assert together.slowest == pytest.approx(0.995)
    ideal = Promise.measured(WAYS, [0.9, 0.9], 0.99, 0.99, 0.011, apart=True)
    assert ideal.later == 0.99
    # What is known of the first tick is no excess: of the first way's, 0.95, all but 0.02 is.
    known = Promise.measured(WAYS, [0.93, 0.9], 0.9, 0.93, 0.011, apart=False)
    assert (known.excess, known.later) == (pytest.approx(0.03), pytest.approx(0.93))


def test_times_by_hand():
    promise = Promise(0.05, 0.9, 0.9, False, 2)
    assert promise.bound(2) == pytest.approx([1.0, 0.95, 0.855])
    assert promise.ticks_home(0.86) == 2
    assert promise.ticks_home(0.96) == 1
    for level in (0.5, 0.01):
        ticks = promise.ticks_home(level)
        bound = promise.bound(ticks)
        assert bound[ticks] <= level < bound[ticks - 1]


def test_where_nothing_can_be_promised():
    for ways in ([], [np.array([0.001])]):
        with pytest.raises(InputError, match=r"none of the ways home .* is free, .*: raise --samples"):
            Promise.measured(ways, [0.9] * len(ways), 0.9, 0.9, 0.011, apart=True)
    with pytest.raises(InputError, match=r"V would fall to 1\.035 of itself a tick only: choose stiffer world\.servo"):
        Promise.measured([np.array([1.0, 0.9, 0.891])], [0.9], 0.9, 0.9, 0.011, apart=True)
