"""With the networks that ship: l_0 of Eq. 4 judges the prediction of a posture, not the distance from home.

Were the LQR's pull left out of what is called m^R, l_0 would be that pull: their correlation was 0.997.
"""

import numpy as np

from diagrams.episodes.calibration import Controller, never_fires, policy_file
from diagrams.episodes.runner import build_rollout
from diagrams.episodes.sampling import episode_seeds
from diagrams.world.names import ARM_JOINTS, ENCODER, WEIGHTS

VALIDATION_BLOCK = 7  # no network is selected or calibrated on its episodes


def test_the_error_of_the_prediction_is_not_the_distance_from_home(world, sampler):
    rollout = build_rollout(world, WEIGHTS / ENCODER, Controller(policy_file(WEIGHTS, "lstm")))
    scaling = rollout.policy.scaling
    home = scaling.scale(world.initial_posture)
    errors, squares, picked = [], [], 0
    for seed in episode_seeds("validation", VALIDATION_BLOCK, 10):
        # Nothing fires, and nothing is divided: l_0 itself.
        calibration = never_fires(rollout.policy.horizon + 1)
        outcome, record = rollout.run(sampler.sample(seed, "none"), calibration=calibration)
        assert record.alpha.max() < 1e-100
        picked += outcome.picked
        errors.append(record.errors[:, 0])
        squares.append(np.mean((scaling.scale(record.posture) - home)[:, :ARM_JOINTS] ** 2, axis=1))
    l_0, square = np.concatenate(errors), np.concatenate(squares)
    assert picked >= 9  # an arm that does not move would prove nothing
    for distance in (square, np.sqrt(square)):
        assert abs(np.corrcoef(l_0, distance)[0, 1]) < 0.3
