"""RegulatedMixer: hand-worked numbers, in float and AutoDiffXd."""

import numpy as np
import pytest

from systems.regulated_mixer import RegulatedMixer
from tests.systems.system_checks import evaluate, evaluate_autodiff

# Gain 0.1; two joints and the fingers.
MIXER = RegulatedMixer(
    posture_size=3, joints=2, initial_posture=[0.1, -0.2, 0.3], Q=1.0, R=90.0, period=0.1,
    lower=-np.ones(3), upper=np.ones(3), max_step=np.full(3, 0.5), settling_ticks=2,
)  # fmt: skip
INPUTS = dict(posture=[0.6, -0.2, 0.7], predicted_posture=[0.7, 0.2, 0.9], alpha=[0.5], last_alphas=[0.0, 1.0])


def test_by_hand():
    assert evaluate(MIXER, "rnn_step", INPUTS) == pytest.approx([0.1, 0.4, 0.2])
    assert evaluate(MIXER, "regulator_step", INPUTS) == pytest.approx([-0.05, 0.0, 0.0], abs=1e-9)
    # The joints at alpha = 1/2, the fingers still at 1.
    assert evaluate(MIXER, "desired_posture", INPUTS) == pytest.approx([0.6, 0.0, 0.7])


def test_under_alpha_one_the_prediction_has_no_say():
    inputs = INPUTS | dict(alpha=[1.0])
    assert evaluate(MIXER, "desired_posture", inputs) == pytest.approx([0.55, -0.2, 0.7])
    value, gradient = evaluate_autodiff(MIXER, "desired_posture", inputs, "predicted_posture")
    assert value == pytest.approx([0.55, -0.2, 0.7])
    assert np.array_equal(gradient, np.zeros((3, 3)))


def test_the_regulator_is_part_of_the_gradient():
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", INPUTS, "posture")
    # m + (1 - alpha) (m^R - m) - K (m - m_init)
    assert gradient == pytest.approx(np.diag([0.4, 0.4, 1.0]), abs=1e-9)
