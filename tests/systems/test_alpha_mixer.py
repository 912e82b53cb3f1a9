"""AlphaMixer: Eq. 3 by hand, the two values of the fingers, bounds; in float and AutoDiffXd."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.alpha_mixer import AlphaMixer
from tests.systems.system_checks import evaluate, evaluate_autodiff


def mixer(joints=2, max_step=0.5):
    return AlphaMixer(
        posture_size=3,
        joints=joints,
        lower=[-1.0, -1.0, -1.0],
        upper=[1.0, 1.0, 1.0],
        max_step=np.full(joints, max_step),
        finger_openings=(-0.6, 0.8),
        finger_thresholds=(-0.1, 0.4),
    )


MIXER = mixer()
INPUTS = dict(
    posture=[0.5, -0.2, 0.8], predicted_posture=[0.6, 0.1, 0.5], regulator_step=[-0.05, 0.02, 0.0], alpha=[0.3]
)


@pytest.mark.parametrize(
    ("alpha", "joints"),
    [
        (0.0, [0.6, 0.1]),  # the network's posture
        (1.0, [0.45, -0.18]),  # the LQR's step
        # dm^R = (0.1, 0.3) - (-0.05, 0.02) = (0.15, 0.28); dm = 0.7 dm^R + dm^L = (0.055, 0.216)
        (0.3, [0.555, 0.016]),
    ],
)
def test_equation_3_by_hand(alpha, joints):
    inputs = INPUTS | dict(alpha=[alpha])
    assert evaluate(MIXER, "rnn_step", inputs) == pytest.approx([0.15, 0.28, -0.3])
    assert evaluate(MIXER, "desired_posture", inputs)[:2] == pytest.approx(joints)


def test_limits_of_speed_and_position():
    inputs = INPUTS | dict(posture=[0.9, -0.2, 0.8], predicted_posture=[1.1, 0.5, 0.5], alpha=[0.0])
    # Steps 0.2 and 0.7: clamped to 0.3 a tick; then the first to the bound 1.
    assert evaluate(mixer(max_step=0.3), "desired_posture", inputs)[:2] == pytest.approx([1.0, 0.1])


CLOSED, OPEN, BELOW, ABOVE = -0.6, 0.8, -0.1, 0.4


@pytest.mark.parametrize(
    ("command", "predicted", "expected"),
    [
        (CLOSED, ABOVE + 1e-9, OPEN), (CLOSED, ABOVE, CLOSED), (CLOSED, 0.2, CLOSED), (CLOSED, -1.0, CLOSED),
        (OPEN, BELOW - 1e-9, CLOSED), (OPEN, BELOW, OPEN), (OPEN, 0.2, OPEN), (OPEN, 1.0, OPEN),
    ],
)  # fmt: skip
@pytest.mark.parametrize("alpha", [0.0, 0.3, np.nextafter(0.5, 0.0), 0.5, 1.0])
def test_fingers_take_two_values_with_hysteresis(command, predicted, expected, alpha):
    """No share of a step, no LQR's step, no speed limit; under alpha >= 1/2 they keep their command."""
    inputs = dict(posture=[0.0, 0.0, command], predicted_posture=[0.0, 0.0, predicted], regulator_step=[0.0, 0.0, 0.3])
    found = evaluate(MIXER, "desired_posture", inputs | dict(alpha=[alpha]))
    assert found.tolist() == [0.0, 0.0, expected if alpha < 0.5 else command]


def test_an_arm_without_fingers():
    arm = AlphaMixer(posture_size=2, joints=2, lower=-np.ones(2), upper=np.ones(2), max_step=np.ones(2))
    inputs = dict(posture=[0.5, 0.0], predicted_posture=[0.6, 0.2], regulator_step=[-0.05, 0.0], alpha=[0.5])
    assert evaluate(arm, "desired_posture", inputs) == pytest.approx([0.525, 0.1])


def test_alpha_mixer_converts():
    value, gradient = evaluate_autodiff(MIXER, "desired_posture", INPUTS, "alpha")
    assert value == pytest.approx([0.555, 0.016, OPEN])
    assert gradient.ravel() == pytest.approx([-0.15, -0.28, 0.0])  # -dm^R; the fingers do not share
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", INPUTS, "predicted_posture")
    assert gradient == pytest.approx(np.diag([0.7, 0.7, 0.0]))
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", INPUTS, "posture")
    assert gradient == pytest.approx(np.diag([0.3, 0.3, 0.0]))  # 0.5 is above the threshold: open, whatever it was
    between = INPUTS | dict(predicted_posture=[0.6, 0.1, 0.2])
    _, gradient = evaluate_autodiff(MIXER, "desired_posture", between, "posture")
    assert gradient == pytest.approx(np.diag([0.3, 0.3, 1.0]))
    _, gradient = evaluate_autodiff(mixer(max_step=0.01), "desired_posture", INPUTS, "alpha")
    assert not gradient.any()  # 0 where a limit holds


numbers = st.floats(-1e6, 1e6)


@settings(max_examples=60, deadline=None)
@given(arrays(float, 3, elements=numbers), arrays(float, 3, elements=numbers), arrays(float, 3, elements=numbers),
       st.floats(0.0, 1.0))  # fmt: skip
def test_mixer_never_leaves_bounds(posture, predicted, regulator_step, alpha):
    inputs = dict(posture=posture, predicted_posture=predicted, regulator_step=regulator_step, alpha=[alpha])
    found = evaluate(MIXER, "desired_posture", inputs)
    assert np.all(np.abs(found) <= 1.0)
    inside = np.clip(posture, -1.0, 1.0)
    found = evaluate(MIXER, "desired_posture", inputs | dict(posture=inside))
    assert np.all(np.abs(found - inside)[:2] <= 0.5 + 1e-12)
    assert found[2] in (CLOSED, OPEN, inside[2])
