"""Branches: an episode that begins with a clone of another run of its scene gives the bits of the whole episode."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.episodes.branching import SCENES, Branches
from diagrams.episodes.episode import Episode
from diagrams.episodes.prefix import BRANCH_LEVELS, Prefix
from diagrams.episodes.record import record_hash
from diagrams.episodes.sampling import ONSET_LEVELS
from diagrams.world.disturbance import DisturbanceSpec

CAN = (0.50, 0.02)
STOPPED = Episode(8, CAN, "right", DisturbanceSpec("B", level=0.15, hold_ticks=8, subtask=2))
TAKEN = replace(STOPPED, disturbance=DisturbanceSpec("B", 0.06, None, 15, 2, [0.61, 0.05]))


def told(outcome):
    return replace(outcome, wall_seconds=0.0, realtime_factor=0.0)


def test_a_branch_gives_the_bits_of_the_whole_episode(rollout, policy, world):
    target = (world.initial_posture[:7] + np.deg2rad([20.0, 0, 0, -10.0, 0, 0, 0])).tolist()
    moved = replace(STOPPED, disturbance=DisturbanceSpec("A", 0.15, target, 10, 2))
    branches = Branches(rollout)
    policy.learn(TAKEN)
    _, first, saved = branches.run(STOPPED, time_limit=18.0)
    assert saved == 0
    for episode in (TAKEN, moved):
        policy.learn(TAKEN)
        outcome, record, saved = branches.run(episode, time_limit=21.0)
        policy.learn(TAKEN)
        whole, by_itself = rollout.run(episode, time_limit=21.0)
        assert record_hash(record) == record_hash(by_itself)
        assert (told(outcome), record.events) == (told(whole), by_itself.events)
        onset = int(np.argmax(record.active))
        assert 100 < saved <= onset < len(record.time) - 20
        # The run that the clone was taken from is undisturbed so far, and the taking changes nothing.
        assert first.posture[:saved].tobytes() == by_itself.posture[:saved].tobytes()


def test_clones_are_kept_at_the_earliest_onset_that_is_sampled():
    assert all(level == max(ONSET_LEVELS[subtask]) for subtask, level in BRANCH_LEVELS.items())


@pytest.mark.parametrize(
    ("given", "serves"),
    [
        (DisturbanceSpec("B", 0.16, None, 15, 2), True),
        (DisturbanceSpec("B", 0.17, None, 15, 2), False),  # begins earlier
        (DisturbanceSpec("B", 0.10, None, 15, 1), False),
        (DisturbanceSpec(), False),
    ],
)
def test_a_prefix_serves_what_does_not_begin_before_its_end(given, serves):
    assert Prefix(None, {"alpha": []}, 2, 0.16).serves(given) == serves


class _Rollout:
    """Keeps a beginning of one tick in every run."""

    def run(self, episode, start=None, keep=None, **options):
        if keep is not None:
            keep(Prefix(None, {"alpha": [0.0]}, 2, 0.16))
        return "outcome", "record"


def test_the_clones_of_the_last_scenes_are_kept():
    branches = Branches(_Rollout())
    saved = [branches.run(replace(STOPPED, can_xy=(0.5, 0.001 * i)))[2] for i in [*range(SCENES + 1), SCENES, 0]]
    assert saved == [0] * (SCENES + 1) + [1, 0]
    first = replace(STOPPED, disturbance=replace(STOPPED.disturbance, subtask=1))
    assert [branches.run(first)[2] for _ in range(2)] == [0, 0]
