"""AlphaMixer: hand-worked numbers, in float and AutoDiffXd; bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.alpha_mixer import AlphaMixer
from tests.systems.system_checks import evaluate, evaluate_autodiff

MIXER = AlphaMixer(
    posture_size=3,
    joints=0,
    lower=[-1.0, -1.0, -1.0],
    upper=[1.0, 1.0, 1.0],
    max_step=[0.2, 0.2, 0.2],
    settling_ticks=3,
)
MIXER_INPUTS = dict(
    posture=[0.5, 0.0, 0.95],
    predicted_posture=[0.6, 2.0, 1.15],
    regulator_step=[-0.05, 0.0, 0.0],
    alpha=[0.5],
    last_alphas=[0.25, 0.0, 0.1],
)
# 0.5 * [0.1, 2, 0.2] + dm^L = [0, 1, 0.1]; clamped to 0.2, added, clamped to 1.
MIXED_POSTURE = [0.5, 0.2, 1.0]


def test_alpha_mixer_by_hand():
    assert evaluate(MIXER, "rnn_step", MIXER_INPUTS) == pytest.approx([0.1, 2.0, 0.2])
    assert evaluate(MIXER, "desired_posture", MIXER_INPUTS) == pytest.approx(MIXED_POSTURE)


def test_regulator_pulls_always_and_fingers_stay_under_alpha_one():
    posture = evaluate(MIXER, "desired_posture", MIXER_INPUTS | dict(alpha=[1.0]))
    assert posture == pytest.approx([0.45, 0.0, 0.95])


@pytest.mark.parametrize("ago", range(3))
def test_a_prediction_from_imagination_or_soon_after_it_moves_nothing(ago):
    inputs = MIXER_INPUTS | dict(alpha=[0.0], last_alphas=np.eye(3)[ago])
    assert evaluate(MIXER, "desired_posture", inputs) == pytest.approx([0.45, 0.0, 0.95])
    assert evaluate(MIXER, "rnn_step", inputs) == pytest.approx([0.1, 2.0, 0.2])


def test_joints_do_not_wait_for_the_fingers():
    mixer = AlphaMixer(
        posture_size=3, lower=-np.ones(3), upper=np.ones(3), max_step=np.ones(3), settling_ticks=3, joints=2
    )
    inputs = MIXER_INPUTS | dict(posture=[0.5, 0.0, 0.5], predicted_posture=[0.6, 0.3, 0.7], alpha=[0.0])
    after = evaluate(mixer, "desired_posture", inputs | dict(last_alphas=[0.0, 0.0, 1.0]))
    assert after == pytest.approx([0.55, 0.3, 0.5])  # steps 0.05, 0.3, 0
    after = evaluate(mixer, "desired_posture", inputs | dict(last_alphas=[0.5, 0.0, 0.0]))
    assert after == pytest.approx([0.5, 0.15, 0.6])  # steps 0, 0.15, 0.1


def test_alpha_mixer_converts():
    value, gradient = evaluate_autodiff(MIXER, "desired_posture", MIXER_INPUTS, "alpha")
    assert value == pytest.approx(MIXED_POSTURE)
    assert gradient.ravel() == pytest.approx([-0.1, 0.0, 0.0])  # -dm^R, and 0 where a limit holds
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", MIXER_INPUTS, "predicted_posture")
    assert gradient == pytest.approx(np.diag([0.5, 0.0, 0.0]))


numbers = st.floats(-1e6, 1e6)


@settings(max_examples=60, deadline=None)
@given(arrays(float, 3, elements=numbers), arrays(float, 3, elements=numbers), arrays(float, 3, elements=numbers),
       st.floats(0.0, 1.0), arrays(float, 3, elements=st.floats(0.0, 1.0)))  # fmt: skip
def test_mixer_never_leaves_bounds(posture, predicted, regulator_step, alpha, last_alphas):
    inputs = dict(posture=posture, predicted_posture=predicted, regulator_step=regulator_step)
    inputs |= dict(alpha=[alpha], last_alphas=last_alphas)
    found = evaluate(MIXER, "desired_posture", inputs)
    assert np.all(np.abs(found) <= 1.0)
    inside = np.clip(posture, -1.0, 1.0)
    step = evaluate(MIXER, "desired_posture", inputs | dict(posture=inside)) - inside
    assert np.all(np.abs(step) <= 0.2 + 1e-12)
