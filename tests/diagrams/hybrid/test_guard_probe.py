"""A displacement in the closed loop with fakes."""

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.hybrid.guard_probe import GuardProbe
from models.errors import InputError


@pytest.fixture(scope="module")
def probe(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    return GuardProbe(rollout, episode, 0.25, 2)


def test_displacement_is_noticed_in_the_closed_loop(probe):
    nothing, _ = probe(np.zeros(7))
    assert nothing < 1e-6
    far = np.deg2rad([15.0, 0, 0, 0, 0, 0, 0])
    assert probe.possible(far)
    assert probe(far)[0] > 0.99


def test_the_controller_samples_the_arm_where_it_was_put(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    probe = GuardProbe(rollout, episode, 0.25, 1)
    displacement = np.deg2rad([12.0, -3.0, 0.0, 8.0, 0.0, 5.0, -9.0])
    probe(displacement)
    controller = rollout.controller
    context = controller.GetMyContextFromRoot(rollout.simulator.get_context())
    sampled = controller.GetOutputPort("measured_posture").Eval(context)
    assert sampled[:7] == pytest.approx(probe.joints + displacement, abs=1e-9)


def test_the_same_displacement_gives_the_same_bits(probe):
    displacement = np.deg2rad([0.4, 0, 0, 0.3, 0, 0, 0])
    first = probe(displacement)
    probe(np.deg2rad([5.0, 0, 0, 0, 0, 0, 0]))
    assert probe(displacement) == first


def test_the_arm_is_not_put_through_limits_or_desk(probe):
    assert probe.possible(np.zeros(7))
    assert not probe.possible(np.deg2rad([0, 0, 0, 60.0, 0, 0, 0]))
    assert not probe.possible(np.deg2rad([0, 30.0, 0, 0, 0, 0, 0]))


def test_a_moment_that_never_comes(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    with pytest.raises(InputError, match="does not come within"):
        GuardProbe(rollout, episode, 1e-4, 2)
