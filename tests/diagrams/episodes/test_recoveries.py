"""Recoveries in the whole closed loop: what ships is what was, and the straight way is the one without the filter."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.episodes.narrator import GIVEN_UP
from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import Clearance
from models.errors import InputError
from systems.recoveries.backoff import BackoffRecovery

SECONDS = 12.0


def run(rollout, policy, episode):
    policy.learn(episode)
    return rollout.run(episode, time_limit=SECONDS)[1]


def has_filter(rollout):
    return "clearance_filter" in [system.get_name() for system in rollout.diagram.GetSystems()]


def test_regulator_is_the_law_without_its_filter_to_the_bit(world, encoder, policy, sampler, rollout):
    episode = next(e for e in (sampler.sample(s, "A") for s in range(100)) if e.disturbance.subtask == 1)
    straight = Rollout(world, encoder, policy, recovery="regulator")
    unseen = Rollout(replace(world, clearance=Clearance(cans="unseen")), encoder, policy)
    found = [run(r, policy, episode) for r in (straight, unseen)]
    assert found[0].alpha.max() == 1.0  # it went home
    assert record_hash(found[0]) == record_hash(found[1])
    assert [has_filter(r) for r in (straight, unseen, rollout)] == [False, False, True]
    planned = Rollout(world, encoder, policy, recovery="planned")
    shipped = [run(r, policy, episode) for r in (planned, rollout)]
    assert record_hash(shipped[0]) == record_hash(shipped[1])


def test_held_under_a_stop_the_arm_waits_for_2_s_and_goes_on(world, encoder, policy, sampler):
    episode = next(e for e in (sampler.sample(s, "B") for s in range(100)) if e.disturbance.subtask == 1)
    record = run(Rollout(world, encoder, policy, recovery="hold"), policy, episode)
    acts = np.flatnonzero(record.alpha > 0.5)
    assert set(record.alpha) == {0.0, 1.0}
    first = acts[0]
    assert record.alpha[first : first + 20].all()
    assert not record.alpha[first + 20 : first + 32].any()
    assert (record.regulator_step[record.alpha < 0.5] == 0.0).all()


def test_with_a_backoff_the_first_return_is_as_without_to_the_bit(world, encoder, policy, sampler, rollout):
    episode = next(e for e in (sampler.sample(s, "A") for s in range(100)) if e.disturbance.subtask == 1)
    found = [run(r, policy, episode) for r in (Rollout(world, encoder, policy, recovery="backoff"), rollout)]
    assert found[0].alpha.max() == 1.0
    assert record_hash(found[0]) == record_hash(found[1])


def test_a_fault_that_stays_gets_the_network_back(world, encoder, policy, sampler):
    """Without a backoff the arm is kept at home for good; with one it is told when the return is given up."""
    episode = next(e for e in (sampler.sample(s, "joint_noise") for s in range(100)) if e.disturbance.subtask == 1)
    high = []
    for recovery in ("planned", "backoff"):
        policy.learn(episode)
        made = Rollout(world, encoder, policy, fault="joint_noise", recovery=recovery)
        _, record = made.run(replace(episode, recovery=recovery), time_limit=18.0)
        high.append(record.alpha >= 0.5)
        given_up = [seconds for seconds, what in record.events if what == GIVEN_UP]
        assert bool(given_up) == (recovery == "backoff")
    assert high[0][-1]
    assert not high[1][-1]
    assert high[1][round(given_up[-1] / 0.1)]
    assert not high[1][round(given_up[-1] / 0.1) + 1]


@pytest.mark.parametrize("backoff", [1.0, "ten", float("nan"), [10.0]])
def test_a_backoff_that_is_none_is_refused_with_its_recovery(world, encoder, policy, monkeypatch, backoff):
    monkeypatch.setattr(BackoffRecovery, "backoff", backoff)
    with pytest.raises(InputError, match=r"the recovery 'backoff' has the backoff .*: give it a number above 1, at"):
        Rollout(world, encoder, policy, recovery="backoff")


def test_a_persons_hands_and_a_backoff_do_not_go_together(world, encoder, policy):
    with pytest.raises(InputError, match="which the recovery 'backoff' raises: leave one out"):
        Rollout(world, encoder, policy, hands=True, recovery="backoff")
