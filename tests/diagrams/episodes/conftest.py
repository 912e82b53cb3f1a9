"""Runs of the whole closed loop that several tests look at."""

import pytest

from diagrams.episodes.episode import Episode
from diagrams.world.disturbance import DisturbanceSpec
from tests.diagrams.episodes.whole_run import CAN, Run


@pytest.fixture(scope="session")
def undisturbed(rollout, policy, encoder):
    return Run(rollout, policy, encoder, Episode(0, CAN, "left"))


def disturbed_by_A(sampler, subtask):
    """The first episode of kind A in that subtask."""
    return next(e for e in (sampler.sample(s, "A") for s in range(100)) if e.disturbance.subtask == subtask)


@pytest.fixture(scope="session")
def moved_before_the_grasp(rollout, policy, encoder, sampler):
    return Run(rollout, policy, encoder, disturbed_by_A(sampler, 1))


@pytest.fixture(scope="session")
def moved_with_the_can(rollout, policy, encoder, sampler):
    return Run(rollout, policy, encoder, disturbed_by_A(sampler, 2))


@pytest.fixture(scope="session")
def robbed(rollout, policy, encoder):
    """Stopped before the shelf; the can is taken and put elsewhere on the desk."""
    taken = DisturbanceSpec("B", level=0.10, hold_ticks=20, subtask=2, can_moved_to=[0.61, 0.05])
    return Run(rollout, policy, encoder, Episode(8, (0.50, 0.02), "right", taken))
