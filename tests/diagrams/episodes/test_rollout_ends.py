"""How a run of the whole closed loop ends: in time, undecided, or in physics that diverge."""

import numpy as np
import pytest

from diagrams.episodes.calibration import never_fires
from diagrams.episodes.episode import Episode
from diagrams.world.disturbance import DisturbanceSpec
from models.errors import InputError
from tests.diagrams.episodes.whole_run import CAN, Run


def test_a_network_that_does_nothing_has_stalled(rollout, policy, encoder, monkeypatch):
    monkeypatch.setattr(policy, "learn", lambda episode: setattr(policy, "_paths", {}) or setattr(policy, "inputs", []))
    monkeypatch.setattr(type(encoder), "encode", lambda self, rgb: np.zeros(self.feature_size))
    run = Run(rollout, policy, encoder, Episode(0, CAN, "left"), time_limit=6.0)
    assert (run.outcome.success, run.outcome.failure, run.outcome.sim_seconds) == (False, "stalled", 6.0)
    assert run.words()[-1] == "time is up"


class Diverging:
    """A simulator whose physics ends after a second: in a step, or with a state that only the next one would find."""

    def __init__(self, simulator, plant=None):
        self._simulator, self._plant = simulator, plant

    def __getattr__(self, name):
        return getattr(self._simulator, name)

    def AdvanceTo(self, seconds):
        if seconds > 1.0 and self._plant is None:
            raise RuntimeError("a non-finite number")
        status = self._simulator.AdvanceTo(seconds)
        if seconds > 1.0:
            context = self._plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
            context.get_mutable_discrete_state_vector().SetAtIndex(self._plant.num_positions() - 1, np.inf)
        return status


@pytest.mark.parametrize("in_a_step", [True, False])
def test_a_run_that_diverges_has_failed_at_both(rollout, policy, encoder, monkeypatch, in_a_step):
    plant = None if in_a_step else rollout.station.plant
    monkeypatch.setattr(rollout, "simulator", Diverging(rollout.simulator, plant))
    run = Run(rollout, policy, encoder, Episode(0, CAN, "left"))
    assert (run.outcome.success, run.outcome.switch_success) == (False, False)
    assert run.outcome.failure == run.outcome.switch_failure == "simulation diverged"
    assert len(run.record.time) == 10


def test_a_run_that_diverges_in_its_first_tick_is_refused(rollout, policy, encoder, monkeypatch):
    monkeypatch.setattr(rollout, "advance", lambda seconds: False)
    with pytest.raises(InputError, match=r"diverges in its first tick: choose a softer world\.servo"):
        Run(rollout, policy, encoder, Episode(0, CAN, "left"))


def test_no_disturbance_came(rollout, policy, encoder):
    """The moment never comes within the time: void, neither a success nor a failure."""
    for given in (
        DisturbanceSpec("B", level=0.01, hold_ticks=20),
        DisturbanceSpec("moved", level=0.01, can_moved_to=[0.5, 0.0]),
    ):
        outcome = Run(rollout, policy, encoder, Episode(0, CAN, "left", given), time_limit=2.0).outcome
        assert (outcome.void, outcome.success, outcome.switch_failure) == (True, None, None)
        expected = None if given.takes_arm else True
        assert (outcome.switch_success, outcome.paper_switch_success) == (expected, expected)
        assert outcome.returned is (False if given.takes_arm else None)


def test_time_disturbed_is_added_to_the_limit(rollout, policy, encoder, moved_before_the_grasp):
    """The network cannot finish within the limit; how long it is given depends on the disturbance."""
    first = moved_before_the_grasp
    run = Run(rollout, policy, encoder, first.episode, time_limit=14.0)
    onset = np.flatnonzero(first.record.active)[0]
    resumed = onset + np.flatnonzero(first.record.alpha[onset + 10 :] <= 0.1)[0] + 10
    assert run.outcome.sim_seconds == pytest.approx(14.0 + 0.1 * (resumed - onset))


def test_a_run_for_the_detection_alone_ends_with_the_disturbance(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="detection")
    assert (outcome.success, outcome.failure, outcome.switch_success, outcome.paper_switch_success) == (None,) * 4
    end = np.flatnonzero(whole.record.active)[-1] + 1
    assert len(record.time) == end + 1
    assert np.array_equal(record.errors, whole.record.errors[: end + 1])


def test_a_run_for_the_switching_alone_goes_on_to_the_end_unless_it_failed(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="switching")
    assert (outcome.success, outcome.failure, outcome.paper_switch_success) == (None, None, None)
    assert (whole.outcome.success, whole.outcome.paper_switch_success) == (True, True)
    for name in ("switch_success", "detection_delay_s", "return_s", "resume_s", "switch_failure", "sim_seconds"):
        assert getattr(outcome, name) == getattr(whole.outcome, name)
    assert np.array_equal(record.errors, whole.record.errors)
    # With a detector that never fires it has failed at the end of the disturbance.
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="switching", calibration=never_fires(11))
    assert (outcome.switch_success, outcome.switch_failure) == (False, "not detected")
    assert len(record.time) == np.flatnonzero(record.active)[-1] + 2


def test_a_run_for_the_paper_s_words_ends_with_the_resumption(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="as_paper")
    assert (outcome.success, outcome.switch_success, outcome.paper_switch_success) == (None, None, True)
    assert record.alpha[-1] <= 0.1 < record.alpha[-2]
