"""What is promised of false alarms: numbers worked out by hand, a promise that is kept, and one that is not."""

import itertools

import numpy as np
import pytest

from diagrams.monitors.promise import Threshold, allowed, fewest, holm, missed, resampled
from models.errors import InputError


@pytest.mark.parametrize(
    ("n", "delta", "count", "least"),
    [(299, 0.01, 3, 99), (99, 0.01, 1, 99), (98, 0.01, 0, 99), (99, 0.29, 29, 3), (19, 0.05, 1, 19), (9, 0.3, 3, 3)],
)
def test_how_many_of_the_scores_lie_at_gamma_or_above(n, delta, count, least):
    assert allowed(n, delta) == count
    assert fewest(delta) == least
    assert (allowed(least, delta), allowed(least - 1, delta)) == (1, 0)


def test_a_count_by_hand():
    """Of 9 scores 2 may lie at gamma or above: P(0) = B(2, 12) / B(2, 8) = 6/13, P(1) = 4 B(3, 11) / B(2, 8)."""
    threshold = Threshold.of(np.array([3.0, 9.0, 1.0, 7.0, 5.0, 2.0, 8.0, 4.0, 6.0]), 0.2)
    assert (threshold.gamma, threshold.promised) == (8.0, 0.2)
    found = threshold.judged(np.array([8.0, 8.5, 9.0, 1.0]))
    assert (found["false_alarms"], found["at_gamma"], found["n"]) == (2, 1, 4)
    assert found["p"] == pytest.approx(1.0 - 6.0 / 13.0 - 576.0 / 1716.0)
    assert found["interval"] == pytest.approx([0.06759, 0.93241], abs=1e-5)  # Clopper and Pearson, of 2 in 4
    assert (found["expected"], found["as_expected"]) == ([0, 3], True)
    assert Threshold.of(np.arange(4.0), 0.5).judged(np.zeros(3))["p"] == 1.0


def test_too_few_runs_are_refused():
    with pytest.raises(InputError, match=r"98 calibration runs are too few for a delta of 0.01: take 99 or more"):
        Threshold.of(np.arange(98.0), 0.01)


def test_holm():
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.5]) == [1.0, 1.0]


def test_runs_drawn_alike_keep_the_promise_and_others_break_it():
    """Of 400 draws the test contradicts a promise that holds in 5 % at most; of drifted runs always."""
    rng = np.random.default_rng(1)
    kept, broken = [], []
    for _ in range(400):
        threshold = Threshold.of(rng.gamma(2.0, size=99), 0.05)
        fresh = rng.gamma(2.0, size=300)
        kept.append(threshold.judged(fresh))
        broken.append(threshold.judged(1.5 * fresh))
    assert 0.02 < np.mean([found["p"] < 0.05 for found in kept]) <= 0.07
    assert 0.92 < np.mean([found["as_expected"] for found in kept]) < 0.98
    assert np.mean([found["false_alarms"] for found in kept]) == pytest.approx(15.0, abs=1.0)
    assert np.mean([found["p"] < 0.05 for found in broken]) > 0.9


def test_all_splits_of_three_scores():
    """With two for the calibration gamma is the larger: it covers the third unless that is the largest, 2 of 3."""
    orders = [np.array(order) for order in itertools.permutations(range(3))]
    found = resampled(np.array([5.0, 1.0, 2.0]), 2, 0.4, orders)
    assert sorted(found["covered"]) == [0, 0, 1, 1, 1, 1]
    assert found["mean"] == pytest.approx(found["expected_mean"]) == pytest.approx(2.0 / 3.0)
    assert found["distance"] == pytest.approx(0.0, abs=1e-12)
    assert (found["central"], found["within"]) == ([0, 1], 1.0)


def test_equal_scores_cover_more_than_is_promised():
    orders = [np.random.default_rng(i).permutation(300) for i in range(50)]
    found = resampled(np.repeat([1.0, 2.0], 150), 99, 0.05, orders)
    assert found["covered"] == [201] * 50
    assert found["distance"] > 0.9


def test_misses_and_their_bound():
    found = missed([0.5, None, 1.5])
    assert (found["n"], found["missed"], found["detection_s"]) == (3, 1, 1.0)
    p = found["bound"]
    assert (1.0 - p) ** 3 + 3.0 * p * (1.0 - p) ** 2 == pytest.approx(0.05)
    assert missed([0.1] * 40)["bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 40.0))
    assert missed([None, None]) == {"n": 2, "missed": 2, "bound": 1.0, "detection_s": None}
    assert missed([])["bound"] == 1.0
