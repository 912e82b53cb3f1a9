"""The episode that a scenario gives: what is left open is sampled, what the arm cannot do is refused."""

import pytest

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.scenario import Scenario
from models.errors import InputError


def test_what_is_not_given_is_sampled(sampler):
    assert sampler.episode(Scenario(seed=3, disturbance=DisturbanceSpec("B"))) == sampler.sample(3, "B")
    assert sampler.episode(Scenario(seed=3, can=[0.5, 0.02])) == sampler.sample(3, "A", can_xy=(0.5, 0.02))


@pytest.mark.parametrize(
    ("disturbance", "named"),
    [
        (
            DisturbanceSpec("A", 0.1, [100.0, *[0.0] * 6]),
            r"target \[100\.0, .* outside of the joint limits: .* \[-2\.79"),
        (DisturbanceSpec("B", 0.1, None, 9, 2, [0.9, 0.0]), r"\(0\.900, 0\.000\) m is out of reach"),
    ],
)  # fmt: skip
def test_what_the_arm_cannot_do_is_no_episode(sampler, disturbance, named):
    scenario = Scenario(disturbance=disturbance)
    scenario.check()
    with pytest.raises(InputError, match=named):
        sampler.episode(scenario)
