"""The rules by which references and gamma are found, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diagrams.episodes.thresholds import (
    ValidationRun,
    by_count,
    by_spread,
    middle_of_spreads,
    most_judged_right,
    rarely_reached,
)
from models.errors import InputError
from tests.diagrams.episode_fakes import OUTCOME, record

PEAKS = st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=8).map(np.array)


def run(kind, success, normal, disturbed=(), active=0):
    return ValidationRun.of(replace(OUTCOME, disturbance=kind, success=success), record(normal, disturbed, active))


def test_peaks_of_a_run():
    # Two criteria; the disturbance lasts for 2 ticks, so its stretch is the next 7: what comes later is the return.
    found = run("A", True, [(1, 4), (3, 2)], [(5, 1)] * 6 + [(7, 1), (90, 90)], active=2)
    assert (found.ticks, found.total.tolist(), found.before.tolist()) == (2, [4, 6], [3, 4])
    assert found.after.tolist() == [7, 1]
    undisturbed = run("none", True, [(1, 4), (3, 2)])
    assert (undisturbed.before.tolist(), undisturbed.after) == ([3, 4], None)
    assert run("A", True, [], [(5, 1)], active=1).before is None  # from the first tick on


def test_references_by_hand():
    # Logarithms 1, 3: mean 2, deviation sqrt(2); and 5, 5.
    found = rarely_reached(np.exp([[1.0, 5.0], [3.0, 5.0]]))
    assert np.log(found) == pytest.approx([2.0 + 2.0 * np.sqrt(2.0), 5.0])
    with pytest.raises(InputError, match="two finished"):
        rarely_reached(np.ones((1, 3)))


def test_middle_of_spreads_by_hand():
    # Logarithms 1, 3 and 7, 11: means 2 and 9, deviations sqrt(2) and sqrt(8): a third of the way, 7 / (3 sqrt(2))
    # deviations from either.
    gamma, deviations = middle_of_spreads(np.exp([1.0, 3.0]), np.exp([7.0, 11.0]))
    assert np.log(gamma) == pytest.approx(2.0 + 7.0 / 3.0)
    assert deviations == pytest.approx(7.0 / (3.0 * np.sqrt(2.0)))


@pytest.mark.parametrize(
    ("normal", "disturbed", "named"),
    [([1.0], [9.0, 9.0], "two finished"), ([5.0, 6.0], [5.0, 5.5], "no larger errors")],
)
def test_no_middle_where_nothing_tells_the_runs_apart(normal, disturbed, named):
    with pytest.raises(InputError, match=named):
        middle_of_spreads(np.array(normal), np.array(disturbed))


@pytest.mark.parametrize(
    ("normal", "disturbed", "gamma"),
    [
        ([1.0, 4.0], [100.0, 900.0], 20.0),  # apart: the geometric middle of the gap
        ([1.0, 4.0, 500.0], [100.0, 900.0], 20.0),  # one false alarm cannot be helped
        ([4.0, 9.0], [16.0, 1.0], 12.0),  # nor that one is not noticed
    ],
)
def test_most_judged_right_by_hand(normal, disturbed, gamma):
    assert most_judged_right(np.array(normal), np.array(disturbed)) == pytest.approx(gamma)


@given(PEAKS, PEAKS)
def test_no_other_gamma_judges_more_of_them_right(normal, disturbed):
    def right(gamma):
        return np.sum(normal < gamma) + np.sum(disturbed >= gamma)

    best = right(most_judged_right(normal, disturbed))
    assert all(right(gamma) <= best for gamma in [*normal, *disturbed, 1e-4, 1e4])


def test_by_spread_by_hand():
    # Both runs peak at 2 in the first criterion, and at 1 and e in the second: references 2 and e^(1/2 + 2 / sqrt(2)).
    undisturbed = [run("none", True, [(1, 1), (2, 1)]), run("none", True, [(2, np.e)]), run("none", False, [(99, 99)])]
    second = np.exp(0.5 + np.sqrt(2.0))
    kinds = {
        "A": [run("A", None, [(50, 1)], [(200, 0)], 1), run("A", None, [(1, 1)], [(200, 0)], 1)],
        "B": [run("B", None, [(1, 1)], [(8, 0)], 1), run("B", None, [(1, 1)], [(8, 0)], 1), run("B", None, [(9, 9)])],
    }
    found = by_spread(undisturbed, kinds)
    assert found.mean_errors == pytest.approx([5 / 3, (2 + np.e) / 3])
    assert found.reference_errors == pytest.approx([2.0, second])
    assert found.normal == pytest.approx([1.0, 1.0])
    assert {kind: peaks.tolist() for kind, peaks in found.disturbed.items()} == {"A": [100, 100], "B": [4, 4]}
    # Nothing spreads: the geometric middle, of A, which comes first where both are infinitely many deviations apart.
    assert found.gamma == pytest.approx(10.0)
    assert "undisturbed 1.0 to 1.0 (median 1.0), disturbance A 100.0 to" in found.words()
    kinds["A"][0] = run("A", None, [(1, 1)], [(2000, 0)], 1)
    assert by_spread(undisturbed, kinds).gamma == pytest.approx(1.0)  # A spreads, all of it above
    with pytest.raises(InputError, match="two finished"):
        by_spread(undisturbed[:1], kinds)


def test_by_count_by_hand():
    undisturbed = [run("none", True, [(1, 2), (3, 2)]), run("none", False, [(99, 99)])]  # that one counts for nothing
    kinds = {
        "A": [run("A", None, [(5, 2)], [(80, 0)], 1)],
        "B": [run("B", None, [(2, 2)])],  # the disturbance never came
    }
    found = by_count(undisturbed, kinds)
    assert found.mean_errors.tolist() == found.reference_errors.tolist() == [2, 2]
    assert found.normal.tolist() == [1.5, 2.5, 1.0]
    assert {kind: peaks.tolist() for kind, peaks in found.disturbed.items()} == {"A": [40], "B": []}
    assert found.gamma == pytest.approx(10.0)  # sqrt(2.5 * 40)
    assert "disturbance B" not in found.words()


@pytest.mark.parametrize(
    ("undisturbed", "named"),
    [
        ([run("none", False, [(1, 1)])], "no undisturbed validation task"),
        ([run("none", True, [(1, 0)])], "criterion 2 has no error at all"),
        ([run("none", True, [(1, 1)])], "no disturbance came"),
    ],
)
def test_by_count_needs_runs(undisturbed, named):
    with pytest.raises(InputError, match=named):
        by_count(undisturbed, {"A": [run("A", None, [(1, 1)])], "B": []})
