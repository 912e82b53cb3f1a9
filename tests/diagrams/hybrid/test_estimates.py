"""Intervals by hand, and against each other."""

import numpy as np
import pytest

from diagrams.hybrid.estimates import Estimate, of_count, of_repetitions
from models.errors import InputError


def test_repetitions_by_hand():
    found = of_repetitions([0.01, 0.02, 0.04], [1e-3] * 3, 100)
    logs = np.log([0.01, 0.02, 0.04])
    variance = np.log(2.0) ** 2
    half = 4.3026527 * np.sqrt(variance / 3 + variance**2 / 4)
    assert found.value == pytest.approx(0.07 / 3)
    assert found.low == pytest.approx(np.exp(logs.mean() + variance / 2 - half))
    assert found.high == pytest.approx(np.exp(logs.mean() + variance / 2 + half))


def test_repetitions_that_agree_have_no_width():
    found = of_repetitions([0.02] * 4, [1e-3] * 4, 100)
    assert [found.value, found.low, found.high] == pytest.approx([0.02] * 3)


def test_an_extinct_repetition_leaves_the_lower_end_open():
    found = of_repetitions([0.0, 0.02, 0.02], [1e-4, 1e-3, 1e-3], 100)
    assert found.low == 0.0
    assert found.value == pytest.approx(0.04 / 3)
    assert found.high >= found.value


def test_where_all_are_extinct_only_what_was_drawn_counts():
    assert of_repetitions([0.0, 0.0], [1e-9, 2e-9], 100) == of_count(0, 100)


def test_the_interval_covers_the_mean_of_a_log_normal_in_19_of_20():
    rng = np.random.default_rng(0)
    drawn = np.exp(0.5 * rng.standard_normal((1000, 6)) - 0.125)  # mean 1
    found = [of_repetitions(0.01 * row, [1e-5] * 6, 100) for row in drawn]
    assert 0.93 < np.mean([f.low <= 0.01 <= f.high for f in found]) < 0.98


def test_one_repetition_is_refused():
    with pytest.raises(InputError, match="--repetitions 2 or more"):
        of_repetitions([0.1], [0.01], 100)


def test_counts_are_exact():
    found = of_count(0, 100)
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(1.0 - 0.025**0.01)
    assert of_count(5, 100).plain() == {"estimate": 0.05, "interval": pytest.approx([0.0164, 0.1128], abs=1e-4)}


def test_intervals_overlap_where_they_have_a_point_in_common():
    a = Estimate(0.2, 0.1, 0.3)
    assert a.overlaps(Estimate(0.4, 0.3, 0.5))
    assert Estimate(0.4, 0.3, 0.5).overlaps(a)
    assert not a.overlaps(Estimate(0.4, 0.31, 0.5))
