"""Recoveries in the whole closed loop: what ships is what was, and the straight way is the one without the filter."""

from dataclasses import replace

import numpy as np

from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import Clearance

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
