"""The rules by which mean errors and gamma are found, worked out by hand, and against scipy and simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import binom

from diagrams.episodes.thresholds import (
    ValidationRun,
    best_in_loop,
    by_count,
    conformal,
    mean_errors,
    misses,
    most_judged_right,
    scores,
    share_above,
    spans,
)
from models.errors import InputError
from tests.diagrams.episode_fakes import OUTCOME, record

PEAKS = st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=8).map(np.array)


def run(kind, success, normal, disturbed=(), active=0):
    return ValidationRun.of(replace(OUTCOME, disturbance=kind, success=success), record(normal, disturbed, active))


def test_peaks_of_a_run():
    # Two criteria; the disturbance lasts for 2 ticks: what comes later is the return.
    found = run("A", True, [(1, 4), (3, 2)], [(5, 1), (7, 1), (90, 90)], active=2)
    assert (found.ticks, found.total.tolist(), found.before.tolist()) == (2, [4, 6], [3, 4])
    assert found.after.tolist() == [7, 1]
    undisturbed = run("none", True, [(1, 4), (3, 2)])
    assert (undisturbed.before.tolist(), undisturbed.after) == ([3, 4], None)
    assert run("A", True, [], [(5, 1)], active=1).before is None  # from the first tick on


def test_a_run_is_kept_to_the_bit():
    for given_run in (run("A", True, [(0.1, 1 / 3)], [(np.pi, 1)], 1), run("none", False, [(1e-300, 2)])):
        back = ValidationRun.of_row(json.loads(json.dumps(given_run.row())))
        assert back.outcome == given_run.outcome
        assert back.row() == given_run.row()


def test_mean_errors_and_scores_by_hand():
    # Three ticks of two runs; the third did not do its task: its errors are no normal ones, but its score counts.
    runs = [run("none", True, [(1, 2), (3, 2)]), run("none", True, [(5, 5)]), run("none", False, [(90, 99)])]
    means = mean_errors(runs)
    assert means.tolist() == [3, 3]
    assert scores([r.before for r in runs], means).tolist() == [1, 5 / 3, 33]
    assert scores([None], means).tolist() == []


@pytest.mark.parametrize(
    ("runs", "named"),
    [
        ([run("none", False, [(1, 1)])], "no undisturbed validation task"),
        ([run("none", True, [(1, 0)])], "criterion 2 has no error at all"),
    ],
)
def test_mean_errors_need_runs(runs, named):
    with pytest.raises(InputError, match=named):
        mean_errors(runs)


@pytest.mark.parametrize(("n", "share"), [(59, 0.05), (149, 0.02), (299, 0.01)])
def test_no_score_above_in_so_many_runs(n, share):
    """Of a share above of exactly `share`, all n runs are below with probability (1 - share)^n < 5 %, n - 1 not."""
    assert (1 - share) ** n <= 0.05 < (1 - share) ** (n - 1)
    assert share_above(n, n) <= share < share_above(n - 1, n - 1)
    assert share_above(n, n) == pytest.approx(1 - 0.05 ** (1 / n))


@pytest.mark.parametrize(("n", "rank"), [(300, 300), (300, 290), (20, 5), (1, 1)])
def test_share_above_is_the_binomial_bound(n, rank):
    """With a larger share above, `rank` or more of n scores are below the quantile with less than 5 %."""
    assert binom.sf(rank - 1, n, 1.0 - share_above(n, rank)) == pytest.approx(0.05)
    assert share_above(n, 0) == 1.0


@pytest.mark.parametrize(
    ("n", "delta", "rank"),
    [(300, 0.01, 300), (299, 0.01, 299), (473, 0.01, 472), (472, 0.01, 472), (100, 0.01, 100), (311, 0.05, 302)],
)
def test_gamma_is_the_smallest_that_keeps_the_bound_or_the_largest_score(n, delta, rank):
    """Wilks' numbers: of 473 runs one may be above for 1 %, of 311 nine for 5 %."""
    drawn = np.random.default_rng(0).permutation(n) + 1.0
    found = conformal(drawn, delta)
    assert (found.rank, found.gamma, found.n) == (rank, float(rank), n)
    assert bool(share_above(n, rank) <= delta) == (n >= 299)
    if rank < n:
        assert share_above(n, rank - 1) > delta
    assert found.average == pytest.approx((n + 1 - rank) / (n + 1))


def test_what_gamma_promises_is_said():
    assert conformal(np.arange(300.0), 0.01).words() == (
        "gamma 299.00, number 300 of the scores of 300 undisturbed runs in rising order: a fresh run has a false alarm "
        "with a probability of at most 0.33% on average over such draws, and with 95% confidence of at most 0.99%"
    )
    assert "of at most 9.50%" in conformal(np.arange(30.0), 0.01).words()  # 1 - 0.05^(1/30)
    with pytest.raises(InputError, match="raise --runs"):
        conformal(np.array([]), 0.01)


def test_the_promise_is_kept():
    """1000 calibrations with 60 scores each: in 95 % of them or more at most 5 % of fresh ones lie above gamma."""
    rng = np.random.default_rng(1)
    above = [1.0 - conformal(rng.uniform(size=60), 0.05).gamma for _ in range(1000)]  # of uniform scores
    assert np.mean(np.array(above) <= 0.05) >= 0.95 - 0.02
    assert np.mean(above) == pytest.approx(1 / 61, rel=0.15)


def test_misses_by_hand():
    disturbed = np.array([30.0, 10.0, 20.0, 40.0])
    found = misses(disturbed, 9.9, 0.2, 0.01)  # an error of 10.1 would be noticed, 10 is not
    assert (found.n, found.missed, found.highest) == (4, 1, pytest.approx(9.8))
    assert "no gamma keeps both bounds" in found.words("B", 9.9)
    assert "1 of 4 not noticed, with 95% confidence at most 75.14% of fresh ones" in found.words("B", 9.9)
    found = misses(disturbed, 9.7, 0.2, 0.01)
    assert (found.missed, found.share) == (0, pytest.approx(1 - 0.05**0.25))
    assert "this gamma keeps both bounds" in found.words("B", 9.7)
    # Of 311, the tenth smallest bounds the misses at 5 %, as the tenth largest does the false alarms.
    assert misses(np.arange(1.0, 312.0), 5.0, 0.0, 0.05).highest == 10.0
    with pytest.raises(InputError, match="raise --disturbed"):
        misses(np.array([]), 1.0, 0.0, 0.01)


def test_spans():
    assert spans({"A": np.array([1.0, 2.0, 9.0]), "B": np.array([])}) == "A 1.0 to 9.0 (median 2.0)"


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
@example(np.array([1.0, 1e-3]), np.array([1.0, np.nextafter(1e-3, 1.0)]))  # no number lies between these two
def test_no_other_gamma_judges_more_of_them_right(normal, disturbed):
    def right(gamma):
        return np.sum(normal < gamma) + np.sum(disturbed >= gamma)

    best = right(most_judged_right(normal, disturbed))
    assert all(right(gamma) <= best for gamma in [*normal, *disturbed, 1e-4, 1e4])


def test_by_count_by_hand():
    undisturbed = [run("none", True, [(1, 2), (3, 2)]), run("none", False, [(6, 6)])]  # that one gives no means
    kinds = {
        "A": [run("A", None, [(5, 2)], [(80, 0)], 1)],
        "B": [run("B", None, [(2, 2)])],  # the disturbance never came
    }
    found = by_count(undisturbed, kinds)
    assert found.mean_errors.tolist() == [2, 2]
    assert found.normal.tolist() == [1.5, 3.0, 2.5, 1.0]
    assert {kind: peaks.tolist() for kind, peaks in found.disturbed.items()} == {"A": [40], "B": []}
    assert found.gamma == pytest.approx(np.sqrt(3.0 * 40.0))
    assert "disturbance B" not in found.words()
    with pytest.raises(InputError, match="no disturbance came"):
        by_count(undisturbed, {"A": [run("A", None, [(1, 1)])], "B": []})


def test_the_best_in_loop_is_of_the_episodes_that_are_not_void(capsys):
    """Void trials are neither successes nor failures: 2 of 2 is better than 3 of 4."""
    right = {
        (30.0, 5.0): [True, True, True, False], (30.0, 10.0): [True, None, True, None], (10.0, 10.0): [None] * 4
    }  # fmt: skip
    beta, gamma, trials = best_in_loop(5.0, [1.0, 2.0], [30.0, 10.0], lambda beta, gamma: right[beta, gamma])
    assert (beta, gamma) == (30.0, 10.0)
    assert [(trial["successes"], trial["episodes"]) for trial in trials] == [(3, 4), (2, 2), (0, 0)]
    assert "2 of 2 switched right" in capsys.readouterr().out
