"""LoopCloser, AlphaMixer and PostureRegulator: hand-worked numbers, in float, AutoDiffXd and Expression."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.alpha_mixer import AlphaMixer
from systems.dwell_time import DwellTime
from systems.loop_closer import LoopCloser
from systems.posture_regulator import lqr, make_posture_regulator
from tests.systems.system_checks import evaluate, evaluate_autodiff, evaluate_symbolic

CLOSER = LoopCloser(posture_size=2, feature_size=1)
CLOSER_INPUTS = dict(
    posture=[1.0, 2.0], features=[0.5], predicted_posture=[0.0, 4.0], predicted_features=[-0.5], alpha=[0.25]
)
MIXER = AlphaMixer(
    posture_size=3, lower=[-1.0, -1.0, -1.0], upper=[1.0, 1.0, 1.0], max_step=[0.2, 0.2, 0.2], settling_ticks=3
)
MIXER_INPUTS = dict(
    posture=[0.5, 0.0, 0.95],
    predicted_posture=[0.6, 2.0, 1.15],
    regulator_step=[-0.05, 0.0, 0.0],
    alpha=[0.5],
    last_alphas=[0.25, 0.0, 0.1],
)
# 0.5 * [0.1, 2, 0.2] + dm^L = [0, 1, 0.1]; clamped to 0.2, added, clamped to 1.
MIXED_STEP, MIXED_POSTURE = [0.0, 1.0, 0.1], [0.5, 0.2, 1.0]


def test_loop_closer_by_hand():
    assert evaluate(CLOSER, "network_input", CLOSER_INPUTS) == pytest.approx([0.75, 2.5, 0.25])
    assert np.array_equal(evaluate(CLOSER, "network_input", CLOSER_INPUTS | dict(alpha=[0.0])), [1.0, 2.0, 0.5])
    assert np.array_equal(evaluate(CLOSER, "network_input", CLOSER_INPUTS | dict(alpha=[1.0])), [0.0, 4.0, -0.5])


def test_loop_closer_converts():
    value, gradient = evaluate_autodiff(CLOSER, "network_input", CLOSER_INPUTS, "alpha")
    assert value == pytest.approx([0.75, 2.5, 0.25])
    assert gradient.ravel() == pytest.approx([-1.0, 2.0, -1.0])  # predicted - measured
    assert evaluate_symbolic(CLOSER, "network_input", CLOSER_INPUTS) == pytest.approx([0.75, 2.5, 0.25])


def test_alpha_mixer_by_hand():
    assert evaluate(MIXER, "rnn_step", MIXER_INPUTS) == pytest.approx([0.1, 2.0, 0.2])
    assert evaluate(MIXER, "regulator_step", MIXER_INPUTS) == pytest.approx([-0.05, 0.0, 0.0])
    assert evaluate(MIXER, "step", MIXER_INPUTS) == pytest.approx(MIXED_STEP)
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
    assert evaluate(mixer, "step", inputs | dict(last_alphas=[0.0, 0.0, 1.0])) == pytest.approx([0.05, 0.3, 0.0])
    assert evaluate(mixer, "step", inputs | dict(last_alphas=[0.5, 0.0, 0.0])) == pytest.approx([0.0, 0.15, 0.1])
    converted = evaluate_symbolic(mixer, "step", inputs | dict(last_alphas=[0.0, 0.0, 1.0]))
    assert converted == pytest.approx([0.05, 0.3, 0.0])


def test_alpha_mixer_converts():
    value, gradient = evaluate_autodiff(MIXER, "desired_posture", MIXER_INPUTS, "alpha")
    assert value == pytest.approx(MIXED_POSTURE)
    assert gradient.ravel() == pytest.approx([-0.1, 0.0, 0.0])  # -dm^R, and 0 where a limit holds
    value, gradient = evaluate_autodiff(MIXER, "step", MIXER_INPUTS, "predicted_posture")
    assert gradient == pytest.approx(0.5 * np.eye(3))
    assert evaluate_symbolic(MIXER, "desired_posture", MIXER_INPUTS) == pytest.approx(MIXED_POSTURE)
    assert evaluate_symbolic(MIXER, "rnn_step", MIXER_INPUTS) == pytest.approx([0.1, 2.0, 0.2])


DWELL = DwellTime(history=4, dwell_ticks=2)


@pytest.mark.parametrize(
    ("last", "alpha"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.8),
        ([1.0, 0.0, 0.0, 0.0], 0.8),  # it stays up
        ([0.2, 0.5, 0.0, 0.0], 0.0),  # it fell at the tick before
        ([0.0, 0.2, 1.0, 0.0], 0.0),  # two ticks before
        ([0.0, 0.0, 0.2, 1.0], 0.8),  # three: the dwell time is over
        ([0.6, 0.2, 1.0, 0.0], 0.0),
    ],
)
def test_dwell_time_by_hand(last, alpha):
    inputs = dict(detector_alpha=[0.8], last_alphas=last)
    assert evaluate(DWELL, "alpha", inputs) == pytest.approx([alpha])
    assert evaluate_symbolic(DWELL, "alpha", inputs) == pytest.approx([alpha])
    value, gradient = evaluate_autodiff(DWELL, "alpha", inputs, "detector_alpha")
    assert value == pytest.approx([alpha])
    assert gradient.ravel() == pytest.approx([1.0 if alpha else 0.0])


def test_no_dwell_time_is_transparent():
    gate = DwellTime(history=1, dwell_ticks=0)
    assert evaluate(gate, "alpha", dict(detector_alpha=[0.8], last_alphas=[0.0])) == pytest.approx([0.8])
    assert evaluate_symbolic(gate, "alpha", dict(detector_alpha=[0.8], last_alphas=[0.0])) == pytest.approx([0.8])
    with pytest.raises(ValueError, match="dwell_ticks is 4, history 4: pass a number below that"):
        DwellTime(history=4, dwell_ticks=4)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60), st.integers(0, 3))
def test_dwell_time_bounds_the_crossings(detector_alphas, ticks):
    """Whatever the detector says, a stay below the guard lasts W + 1 ticks at least."""
    gate, past = DwellTime(history=4, dwell_ticks=ticks), [0.0] * 4
    for alpha in detector_alphas:
        past.insert(0, float(evaluate(gate, "alpha", dict(detector_alpha=[alpha], last_alphas=past[:4]))[0]))
    high = "".join("1" if alpha >= 0.5 else "0" for alpha in reversed(past))
    assert all(len(stay) > ticks for stay in high.split("1")[1:-1] if stay)


def test_conversion_back_and_forth_keeps_the_limits():
    symbolic = MIXER.ToAutoDiffXd().ToSymbolic()
    context = symbolic.CreateDefaultContext()
    for name, value in MIXER_INPUTS.items():
        symbolic.GetInputPort(name).FixValue(context, np.array(value))
    found = [x.Evaluate() for x in symbolic.GetOutputPort("desired_posture").Eval(context)]
    assert found == pytest.approx(MIXED_POSTURE)


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


def test_lqr_by_hand():
    # s = q/2 (1 + sqrt(1 + 4 r/q)) = (1 + 19)/2 = 10; k = s/(r + s) = 0.1.
    K, S = lqr(3, 1.0, 90.0, 0.1)
    assert pytest.approx(0.1 * np.eye(3), abs=1e-9) == K
    assert pytest.approx(10.0 * np.eye(3), abs=1e-7) == S


def test_regulator_by_hand():
    initial = np.array([0.1, -0.2, 0.3, 0.04])
    regulator = make_posture_regulator(posture_size=4, joints=3, initial_posture=initial, Q=1.0, R=90.0, period=0.1)
    assert regulator.get_name() == "posture_regulator"
    inputs = dict(posture=initial + np.array([1.0, -2.0, 0.0, 5.0]))
    assert evaluate(regulator, "step", inputs) == pytest.approx([-0.1, 0.2, 0.0, 0.0], abs=1e-9)
    assert evaluate(regulator, "step", dict(posture=initial)) == pytest.approx(np.zeros(4), abs=1e-15)
    value, gradient = evaluate_autodiff(regulator, "step", inputs, "posture")
    assert value == pytest.approx([-0.1, 0.2, 0.0, 0.0], abs=1e-9)
    assert gradient == pytest.approx(np.diag([-0.1, -0.1, -0.1, 0.0]), abs=1e-9)
    assert evaluate_symbolic(regulator, "step", inputs) == pytest.approx([-0.1, 0.2, 0.0, 0.0], abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 8), st.floats(0.01, 100.0), st.floats(0.01, 1e4), arrays(float, 8, elements=st.floats(-3, 3)))
def test_lqr_contracts_and_its_cost_to_go_falls_by_the_stage_cost(joints, Q, R, deviation):
    K, S = lqr(joints, Q, R, 0.1)
    m = deviation[:joints]
    step = -K @ m
    after = m + step
    assert np.linalg.norm(after) <= np.linalg.norm(m)
    assert np.all(np.abs(np.linalg.eigvals(np.eye(joints) - K)) < 1.0)
    stage = Q * m @ m + R * step @ step
    assert m @ S @ m - after @ S @ after == pytest.approx(stage, rel=1e-6, abs=1e-12)


def test_lqr_takes_matrices():
    K, S = lqr(2, np.diag([1.0, 4.0]), np.diag([90.0, 90.0]), 0.1)
    s = 2.0 * (1.0 + np.sqrt(1.0 + 4.0 * 90.0 / 4.0))
    assert pytest.approx(np.diag([0.1, s / (90.0 + s)]), abs=1e-8) == K
    assert pytest.approx(np.diag([10.0, s]), rel=1e-6) == S
