"""Adaptive multilevel splitting on problems whose probability is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, kstest, norm

from diagrams.hybrid.estimates import of_repetitions
from diagrams.hybrid.splitting import Kernel, Stage, above_level, copies, split, stage_level
from models.errors import InputError

SIZE = 6
KERNEL = Kernel([np.arange(2), np.arange(2, 5), np.array([5])], [0.25, 0.5, 0.5])
# Of the normal distribution in 6 dimensions: the largest number, the norm, the first number in steps, and with nothing
# to climb below 1.5.
LEVELS = {
    "maximum": lambda x: x.max(axis=1),
    "norm": lambda x: np.linalg.norm(x, axis=1),
    "ties": lambda x: np.floor(4.0 * x[:, 0]) / 4.0,
    "plateau": lambda x: np.where(x[:, 0] < 1.5, 0.0, x[:, 0]),
}


def target_of(name, probability):
    """The target that is reached with that probability."""
    if name == "maximum":
        return float(norm.ppf((1.0 - probability) ** (1.0 / SIZE)))
    return float(chi2.isf(probability, SIZE) ** 0.5) if name == "norm" else float(norm.isf(probability))


def run(level_of, target, seed, population=100, kept=0.3, moves=4, **options):
    rng = np.random.default_rng(seed)
    return split(level_of, KERNEL, SIZE, target, population=population, kept=kept, moves=moves, rng=rng, **options)


def runs(levels, target, seed, count, population, **options):
    """Independent runs with the levels of a pilot."""
    pilot = run(levels, target, [seed, 0], population, **options)
    given = [stage.level for stage in pilot.stages]
    return [run(levels, target, [seed, r], population, levels=given, **options) for r in range(1, count + 1)]


def estimate_of(found):
    return of_repetitions([r.estimate for r in found], [r.smallest for r in found], 1)


def within_errors(found, probability):
    """Whether the mean is within 3.5 standard errors of the truth, and these are no large part of it."""
    estimates = np.array([r.estimate for r in found])
    error = estimates.std(ddof=1) / np.sqrt(len(found))
    return abs(estimates.mean() - probability) < 3.5 * error < probability


def test_what_is_rarer_is_not_looked_for():
    """A target far out of reach: what is above the last level has a known probability, about as rare as asked for."""
    found = runs(LEVELS["norm"], 50.0, 0, 12, 300, rarest=1e-3)
    last = len(found[0].stages) - 1
    passed = np.array([above_level(r, last) for r in found])
    truth = chi2.sf(found[0].stages[-1].level ** 2, SIZE)
    assert 1e-3 / 5 < truth < 1e-3
    assert abs(passed.mean() - truth) < 3.5 * passed.std(ddof=1) / np.sqrt(len(found)) < truth
    assert above_level(found[0], 0) == found[0].stages[0].share
    assert above_level(found[0], last + 1) == 0.0
    assert all(r.extinct and r.estimate == 0.0 and len(r.stages) == len(found[0].stages) for r in found)
    with pytest.raises(InputError, match="do not reach 50 in 100 stages"):
        run(LEVELS["norm"], 50.0, 0)


@pytest.mark.parametrize("probability", [1e-2, 1e-5])
@pytest.mark.parametrize("name", ["maximum", "norm"])
def test_known_probabilities(name, probability):
    found = runs(LEVELS[name], target_of(name, probability), 0, 12, 300)
    estimate = estimate_of(found)
    assert within_errors(found, probability)
    assert estimate.low < estimate.value < estimate.high
    assert max(r.evaluations for r in found) < 15_000  # brute force: one success in 100,000


@pytest.mark.parametrize(("name", "target"), [("ties", 2.25), ("ties", 4.0), ("plateau", 2.5)])
def test_ties_and_plateaus(name, target):
    probability = float(norm.sf(target))
    found = runs(LEVELS[name], target, 1, 24, 300)
    assert within_errors(found, probability)
    # What is counted is what stayed, not the share asked for.
    assert len({stage.share for r in found for stage in r.stages}) > 5


def test_intervals_cover_the_truth_in_19_of_20():
    covered = []
    for trial in range(80):
        estimate = estimate_of(runs(LEVELS["norm"], target_of("norm", 3e-3), trial, 5, 50))
        covered.append(estimate.low <= 3e-3 <= estimate.high)
    assert 69 <= sum(covered) <= 80  # 76 expected; fewer than 69 by chance in 1 of 500


@pytest.mark.parametrize(("name", "target"), [("norm", target_of("norm", 1e-2)), ("ties", 2.25)])
def test_estimates_are_unbiased_even_where_copies_hardly_move(name, target):
    probability = 1e-2 if name == "norm" else float(norm.sf(target))
    levels = [stage.level for stage in run(LEVELS[name], target, 0).stages]
    found = [run(LEVELS[name], target, seed, 40, moves=1, levels=levels).estimate for seed in range(1, 801)]
    assert abs(np.mean(found) - probability) < 3.5 * np.std(found) / np.sqrt(len(found))


def test_a_level_that_says_nothing_is_brute_force():
    """No way up: all of one level, or at the target."""
    found = run(lambda x: np.zeros(len(x)), 1.0, 0)
    assert (found.estimate, found.extinct, found.stages, found.evaluations) == (0.0, True, [], 100)
    assert found.smallest == pytest.approx(0.01)
    none = run(lambda x: x[:, 0], 3.0, 0, levels=[0.0, 9.0])
    assert (none.estimate, none.extinct, len(none.stages)) == (0.0, True, 1)
    assert none.smallest == none.stages[0].share / 100
    assert sum(weight for _, weight in none.weights) == pytest.approx(1.0)
    found = run(lambda x: np.full(len(x), 1.0), 1.0, 0)
    assert (found.estimate, found.extinct) == (1.0, False)
    drawn = []
    found = run(lambda x: drawn.append(x) or (x[:, 0] > 0.0).astype(float), 1.0, 0)
    assert found.estimate == np.mean(drawn[0][:, 0] > 0.0)


def test_same_seed_same_bits():
    first, again = (run(LEVELS["maximum"], 4.0, 7) for _ in range(2))
    assert first == again
    given = [stage.level for stage in first.stages]
    assert run(LEVELS["maximum"], 4.0, 9, levels=given) == run(LEVELS["maximum"], 4.0, 9, levels=given)
    assert run(LEVELS["maximum"], 4.0, 8).estimate != first.estimate


def test_stages_are_told_as_they_come():
    told = list[Stage]()
    found = run(LEVELS["norm"], target_of("norm", 1e-4), 1, on_stage=told.append)
    assert told == found.stages
    levels = [stage.level for stage in told]
    assert levels == sorted(levels)
    assert all(0.0 < stage.taken < 1.0 and 0.2 < stage.share < 0.4 for stage in told)
    assert found.evaluations == 100 + len(told) * 100 * 4


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(5, 60), st.sampled_from([0.2, 0.3, 0.5, 0.75]), st.integers(1, 3),
    st.sampled_from(sorted(LEVELS)), st.floats(0.5, 3.5),
)  # fmt: skip
def test_weights_are_a_distribution_and_give_the_estimate(seed, population, kept, moves, name, target):
    asked = []

    def levels(x):
        asked.extend(LEVELS[name](x))
        return LEVELS[name](x)

    found = run(levels, target, seed, population, kept, moves)
    assert len(asked) == found.evaluations
    numbers, weights = zip(*found.weights, strict=True)
    assert sum(weights) == pytest.approx(1.0)
    assert 0 <= min(numbers) <= max(numbers) < found.evaluations
    reached = sum(weight for number, weight in found.weights if asked[number] >= target)
    assert reached == pytest.approx(found.estimate)
    assert 0.0 <= found.estimate <= 1.0
    assert found.extinct == (found.estimate == 0.0)


def test_weights_give_the_mean_of_anything():
    """Here of whether the last number is positive, given nothing: 1/2; and of a rare event beside the level's."""
    halves = []
    for seed in range(40):
        points = []
        found = run(lambda x, kept=points: kept.extend(x[:, -1]) or x[:, 0], 2.5, seed)
        halves.append(sum(weight for number, weight in found.weights if points[number] > 0.0))
    assert np.mean(halves) == pytest.approx(0.5, abs=4 * np.std(halves) / np.sqrt(40))


def test_each_is_copied_as_often_as_the_others():
    alive, rng = np.array([2, 5, 7]), np.random.default_rng(0)
    counts = np.array([np.bincount(copies(alive, 8, rng), minlength=8)[alive] for _ in range(300)])
    assert np.all((counts == 2) | (counts == 3))
    assert np.all(counts.sum(axis=1) == 8)
    assert counts.mean(axis=0) == pytest.approx([8 / 3] * 3, abs=0.1)


@pytest.mark.parametrize(
    ("levels", "kept", "level"),
    [
        ([1, 2, 3, 4, 5], 0.4, 3.0),  # 4 and 5 stay
        ([1, 2, 3, 4, 5], 0.01, 4.0),  # at least one stays
        ([1, 3, 3, 3, 5], 0.4, 3.0),  # ties: one stays, nearer to two than four
        ([1, 3, 3, 4, 5], 0.6, 3.0),  # as near: fewer stay
        ([1, 1, 3, 3, 5], 0.6, 1.0),
        ([1, 2, 5, 5, 5], 0.4, 2.0),  # a plateau at the top: three stay
        ([3, 3, 3, 3, 3], 0.4, None),
        ([1, 1, 9, 9, 9], 0.4, None),  # three reach the target of 7: more than are asked for
        ([1, 1, 1, 9, 9], 0.4, None),
        ([1, 1, 1, 2, 9], 0.4, 1.0),
        ([-np.inf, -np.inf, 1, 2, 3], 0.6, -np.inf),
    ],
)
def test_level_of_a_stage_by_hand(levels, kept, level):
    assert stage_level(np.array(levels, float), kept, 7.0) == level


def test_kernel_is_reversible_for_the_normal_distribution():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((20_000, SIZE))
    y = KERNEL.propose(x, rng)
    assert all(kstest(y[:, i], "norm").pvalue > 1e-4 for i in range(SIZE))
    # Detailed balance: (x, y) is distributed as (y, x).
    for f, g in ((np.sign, np.square), (np.exp, np.abs), (lambda v: v > 1.0, lambda v: v > 0.0)):
        difference = f(x[:, 0]) * g(y[:, 0]) * 1.0 - g(x[:, 0]) * f(y[:, 0])
        assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(len(x))
    moved = x != y
    assert np.array_equal(moved[:, 0], moved[:, 1])
    assert np.array_equal(moved[:, 2], moved[:, 4])
    assert moved.any(axis=1).all()
    assert moved[:, 0].mean() < moved[:, 2].mean() < 0.7


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"kept": 0.0}, "--kept 0 is no share"),
        ({"kept": 1e-320}, "--kept 9.99989e-321 is no share .*: choose a number from 0.001 to 0.999"),
        ({"kept": 1.0}, "--kept 1 is no share"),
        ({"population": 3}, "--population 3 is too small to keep a share of 0.3: choose 4 or more"),
        ({"moves": 0}, "--moves 0 is too small"),
    ],
)
def test_sizes_that_make_no_run_are_named(options, named):
    with pytest.raises(InputError, match=named):
        run(LEVELS["norm"], 3.0, 0, **options)


def test_a_climb_without_an_end_is_named(monkeypatch):
    monkeypatch.setattr("diagrams.hybrid.splitting.MOST_STAGES", 3)
    with pytest.raises(InputError, match=r"do not reach 50 in 3 stages .*: raise --moves"):
        run(LEVELS["norm"], 50.0, 0)


def test_levels_of_the_wrong_shape_are_named():
    with pytest.raises(ValueError, match="they must be 100 numbers"):
        run(lambda x: np.zeros(3), 1.0, 0)
