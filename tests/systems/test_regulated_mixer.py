"""RegulatedMixer: hand-worked numbers, in float and AutoDiffXd."""

import numpy as np
import pytest

from systems.regulated_mixer import RegulatedMixer
from tests.systems.system_checks import evaluate, evaluate_autodiff

# Gain 0.1; two joints and the fingers.
MIXER = RegulatedMixer(
    posture_size=3, joints=2, initial_posture=[0.1, -0.2, 0.3], Q=1.0, R=90.0, period=0.1,
    lower=-np.ones(3), upper=np.ones(3), max_step=np.full(2, 0.5),
    finger_openings=(-0.5, 0.7), finger_thresholds=(-0.2, 0.2),
)  # fmt: skip
INPUTS = dict(posture=[0.6, -0.2, 0.7], predicted_posture=[0.7, 0.2, -0.3], alpha=[0.4])


def test_by_hand():
    # dm^L = -0.1 (0.5, 0); dm^R = (0.1, 0.4, -1) - dm^L.
    assert evaluate(MIXER, "regulator_step", INPUTS) == pytest.approx([-0.05, 0.0, 0.0], abs=1e-9)
    assert evaluate(MIXER, "rnn_step", INPUTS) == pytest.approx([0.15, 0.4, -1.0])
    # 0.6 (0.15, 0.4) + (-0.05, 0) = (0.04, 0.24); the fingers close.
    assert evaluate(MIXER, "desired_posture", INPUTS) == pytest.approx([0.64, 0.04, -0.5])


def test_under_alpha_one_the_prediction_has_no_say():
    inputs = INPUTS | dict(alpha=[1.0])
    assert evaluate(MIXER, "desired_posture", inputs) == pytest.approx([0.55, -0.2, 0.7])
    value, gradient = evaluate_autodiff(MIXER, "desired_posture", inputs, "predicted_posture")
    assert value == pytest.approx([0.55, -0.2, 0.7])
    assert np.array_equal(gradient, np.zeros((3, 3)))


def test_the_regulator_is_part_of_the_gradient():
    inputs = INPUTS | dict(predicted_posture=[0.7, 0.2, 0.0])
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", inputs, "posture")
    # m + (1 - alpha) (m^R - m) - alpha K (m - m_init); the fingers keep their command.
    assert gradient == pytest.approx(np.diag([0.4 - 0.04, 0.4 - 0.04, 1.0]), abs=1e-9)
