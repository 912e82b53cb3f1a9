"""Evidence: by hand, as a martingale, and how often equal controllers are called different, looked at every time."""

import json

import numpy as np
import pytest
from scipy.special import comb

from diagrams.sweeps.sequential import DECIDED, decided, evidence, evidence_of, paired, rounds
from tests.diagrams.sweep_fakes import make_task


def test_by_hand():
    # a = 1: B(1 + k, 1 + m - k) = 1 / ((m + 1) C(m, k)).
    assert evidence(5, 5, prior=1.0) == pytest.approx(2**5 / 6)
    assert evidence(3, 4, prior=1.0) == pytest.approx(2**4 / (5 * 4))
    assert evidence(0, 0) == 1.0
    assert evidence(1, 1) == pytest.approx(1.0)  # one pair says nothing of a fair coin
    assert evidence(2, 2) == pytest.approx(1.5)  # a = 1/2: 4 * (1/2 * 3/2) / (1 * 2)
    assert evidence(7, 7) > DECIDED > evidence(np.array([6, 5]), 6).max()  # 7 to none decides


@pytest.mark.parametrize("prior", [0.5, 1.0, 7.0])
def test_its_mean_under_a_fair_coin_is_1(prior):
    for m in (1, 2, 9, 40):
        k = np.arange(m + 1)
        assert np.sum(comb(m, k) / 2.0**m * evidence(k, m, prior)) == pytest.approx(1.0)


def test_it_is_the_same_for_both_sides_and_does_not_overflow_to_nan():
    assert evidence(3, 20) == pytest.approx(evidence(17, 20))
    assert evidence(5000, 5000) == np.inf
    for wrong in ((3, 2), (-1, 2)):
        with pytest.raises(ValueError, match="0 <= wins <= discordant"):
            evidence(*wrong)


def test_equal_controllers_are_called_different_in_at_most_5_percent_at_any_look():
    """10,000 comparisons of 300 discordant pairs, looked at after each of them."""
    rng = np.random.default_rng(0)
    wins = np.cumsum(rng.random((10_000, 300)) < 0.5, axis=1)
    ever = (evidence(wins, np.arange(1, 301)) >= DECIDED).any(axis=1)
    assert 0.0 < ever.mean() <= 0.05


def test_a_better_one_is_found():
    rng = np.random.default_rng(1)
    wins = np.cumsum(rng.random((1000, 300)) < 0.7, axis=1)
    ever = (evidence(wins, np.arange(1, 301)) >= DECIDED).any(axis=1)
    assert ever.mean() > 0.95


def test_pairs_by_hand():
    """Scene 0: 2 to 1, 1: one each, 2: alike, 3: 0 to 1."""
    found = paired([(0, 1), (0, 1), (0, -1), (1, 1), (1, -1), (2, 0), (3, -1)])
    assert found == {
        "n": 7, "only_a": 3, "only_b": 3, "scenes": 4, "scenes_a": 1, "scenes_b": 1, "e": pytest.approx(0.5),
    }  # fmt: skip
    json.dumps(paired([(scene, 1) for scene in range(2000)]), allow_nan=False)


def tasks_of(scenes, kinds=("A",), training_seeds=(0,)):
    return [
        make_task(seed, kind, detector=detector, training_seed=training_seed)
        for detector in ("recall", "never")
        for kind in kinds
        for seed in range(scenes)
        for training_seed in training_seeds
    ]


def test_evidence_of_rows_is_of_scenes():
    """Scene 0: 2 against 1 of the training seeds; 1: 1 against 2; 2: 1 each; 3: one of the two is missing."""
    done = {"recall": [(1, 1), (0, 1), (1, 0), (1, 1)], "never": [(0, 1), (1, 1), (0, 1), (None, None)]}
    tasks = tasks_of(4, training_seeds=(0, 1))
    rows = {t.key: {"success": done[t.detector][t.seed][t.training_seed]} for t in tasks}
    assert evidence_of(tasks, rows) == pytest.approx(float(evidence(1, 2)))
    assert evidence_of(tasks[::-1], rows) == pytest.approx(float(evidence(1, 2)))
    assert evidence_of(tasks, {}) == 1.0


def test_rounds_end_where_a_disturbance_is_decided():
    """Under A one of the two does each task and the other none, under B both do: A is over after seven scenes."""
    tasks = tasks_of(10, kinds=("A", "B"))
    rows = {}
    left = {task.key for task in tasks}
    for some in rounds(tasks, rows, left):
        for task in some:
            rows[task.key] = {"success": task.detector == "recall" or task.disturbance == "B"}
    run = [task for task in tasks if task.key in rows]
    assert [sum(t.disturbance == kind for t in run) for kind in "AB"] == [14, 20]
    assert decided(tasks, rows) == {"A": pytest.approx(float(evidence(7, 7)))}
    assert not any(rounds(tasks, rows, left - set(rows)))


def test_each_severity_of_a_fault_is_a_comparison_of_its_own():
    """At severity 1 one of the two does each task and the other none, at 0.5 both do."""
    tasks = [
        make_task(seed, "payload", detector=detector, severity=severity)
        for detector in ("recall", "never")
        for severity in (0.5, 1.0)
        for seed in range(8)
    ]
    rows = {task.key: {"success": task.detector == "recall" or task.severity == 0.5} for task in tasks}
    assert decided(tasks, rows) == {"payload-1.0": pytest.approx(float(evidence(8, 8)))}
