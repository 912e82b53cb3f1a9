"""A threshold that goes with the phase: what the phase is, what is fitted to it, and what it promises."""

import numpy as np
import pytest

from diagrams.monitors.phase_band import Band, phases
from diagrams.monitors.promise import Threshold
from diagrams.world.configuration import World

HOME = World().initial_posture


def posture(away, closed):
    """(T, 8): where the arm is away from home, and its fingers closed."""
    found = np.tile(HOME, (len(away), 1))
    found[:, 3] += np.where(away, 0.5, 0.02)  # rad
    found[:, 7] = np.where(closed, 0.0, HOME[7])
    return found


def test_phase_counts_from_home_and_the_fingers_there_tell_the_subtask():
    away, closed = [0, 0, 1, 1, 1, 0, 1, 1, 0], [0, 0, 0, 1, 1, 1, 1, 0, 0]
    found = phases(posture(np.array(away), np.array(closed)), HOME)
    assert found[:, 1].tolist() == [0, 0, 1, 2, 3, 0, 1, 2, 0]
    assert found[:, 0].tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 0]
    begun_away = phases(posture(np.array([1, 1, 0]), np.array([1, 1, 0])), HOME)
    assert begun_away.tolist() == [[1, 0], [1, 1], [0, 0]]
    # Known in the tick: what comes later changes nothing.
    for ticks in range(1, 10):
        part = phases(posture(np.array(away[:ticks]), np.array(closed[:ticks])), HOME)
        assert np.array_equal(part, found[:ticks])


def test_mean_and_scale_of_each_phase():
    """Two runs to phase 2, one to 4: what half of the runs do not come to is one phase with the last that they do."""
    at = lambda *ticks: np.array([(0, k) for k in ticks])  # noqa: E731
    ratios = [np.array([0.0, 1.0, 5.0]), np.array([0.0, 3.0, 7.0]), np.array([0.0, 2.0, 6.0, 8.0, 9.0])]
    band = Band.fit(ratios, [at(0, 1, 2), at(0, 1, 2), at(0, 1, 2, 3, 4)])
    assert band.mean[0] == pytest.approx([0.0, 2.0, 7.0])
    least = 0.1 * np.concatenate(ratios).std()
    assert band.scale[0] == pytest.approx([least, np.sqrt(2.0 / 3.0), np.sqrt(2.0)])
    found = band.scores(np.array([2.0, 7.0 + np.sqrt(8.0)]), at(1, 50))
    assert found == pytest.approx([0.0, 2.0])
    # Of the subtask that no run had, what is known of all ticks.
    assert band.mean[1] == pytest.approx([np.concatenate(ratios).mean()])


def test_runs_that_are_all_alike_have_a_scale():
    band = Band.fit([np.ones(3)], [np.zeros((3, 2), int)])
    assert band.scores(np.ones(2), np.zeros((2, 2), int)).tolist() == [0.0, 0.0]


def test_it_keeps_the_promise_and_sees_what_a_constant_threshold_does_not():
    """A score that is high in one phase alone: a jump elsewhere, lower than that, is above the band only."""
    rng, ticks = np.random.default_rng(0), 40
    phase = np.stack((np.zeros(ticks, int), np.arange(ticks)), axis=1)
    usual = 1.0 + 9.0 * (np.arange(ticks) == 20)

    def runs(count):
        return [usual * (1.0 + 0.1 * rng.standard_normal(ticks)) for _ in range(count)]

    band = Band.fit(runs(200), [phase] * 200)
    gamma = Threshold.of(np.array([band.scores(run, phase).max() for run in runs(199)]), 0.05)
    constant = Threshold.of(np.array([run.max() for run in runs(399)]), 0.05)
    fresh = runs(600)
    assert gamma.judged(np.array([band.scores(run, phase).max() for run in fresh]))["p"] > 0.01
    jumped = [run + 5.0 * (np.arange(ticks) == 30) for run in fresh]
    assert np.mean([band.scores(run, phase)[30] > gamma.gamma for run in jumped]) == 1.0
    assert np.mean([run[30] > constant.gamma for run in jumped]) == 0.0
