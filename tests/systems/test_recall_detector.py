"""RecallDetector: hand-worked numbers, the formula bit by bit, alpha in [0, 1] for any errors, conversion."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.detectors import DETECTORS
from systems.recall_detector import RecallDetector
from tests.systems.system_checks import evaluate, evaluate_autodiff

# m_k, m_{k-1} (which is not judged), m_{k-2} against m^R_k and the recalled m^R_{k-2}: l = [(0.1^2 + 0.3^2)/2, 0.2^2/2]
# = [0.05, 0.02].
INPUTS = dict(
    posture_history=[0.1, 0.3, 9.0, 9.0, 0.5, 0.7], recalled_postures=[0.0, 0.0, 0.5, 0.5], hidden_state=[0.0, 0.0, 0.0]
)
MEANS = [0.1, 0.01]
SIZES = SimpleNamespace(posture_size=2, horizon=1, state_size=3)
SYSTEM = RecallDetector(SIZES, joints=2)


def test_by_hand():
    assert evaluate(SYSTEM, "errors", INPUTS, (MEANS, 1.0, 1.0)) == pytest.approx([0.5, 2.0])
    alpha = evaluate(SYSTEM, "alpha", INPUTS, (MEANS, 1.0, 1.0))
    assert alpha == pytest.approx([1.0 / (1.0 + np.exp(-1.0))])  # of row 1, the larger
    alpha = evaluate(SYSTEM, "alpha", INPUTS, (MEANS, 3.0, 3.0))
    assert alpha == pytest.approx([1.0 / (1.0 + np.exp(3.0))])


def test_without_a_calibration_errors_are_squared_errors_and_nothing_fires():
    assert evaluate(SYSTEM, "errors", INPUTS) == pytest.approx([0.05, 0.02])
    far = INPUTS | dict(recalled_postures=np.full(4, 2.0))  # the largest that scaled postures allow
    assert evaluate(SYSTEM, "alpha", far) == pytest.approx([0.0], abs=1e-200)


# The picture beside it: features (0.6 - 0.2)^2 / 2 = 0.08.
SEEN = SimpleNamespace(**vars(SIZES), feature_size=2)
BOTH = INPUTS | dict(features=[0.6, 0.5], predicted_features=[0.2, 0.5])


def test_recall_and_innovation_together_by_hand():
    """The errors are those of the two detectors alone, alpha the largest of all: here of the picture."""
    system = DETECTORS["recall_innovation"].build(SEEN, 2, DETECTORS["recall_innovation"].fit([]))
    ports = [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]
    assert set(ports) == set(BOTH)
    assert evaluate(system, "errors", BOTH) == pytest.approx([0.05, 0.02, 0.08])
    calibration = [*MEANS, 0.02], 1.0, 1.0
    assert evaluate(system, "errors", BOTH, calibration) == pytest.approx([0.5, 2.0, 4.0])
    assert evaluate(system, "alpha", BOTH, calibration) == pytest.approx([1.0 / (1.0 + np.exp(-3.0))])
    alone = evaluate(SYSTEM, "errors", INPUTS, (MEANS, 1.0, 1.0))
    assert evaluate(system, "errors", BOTH, calibration)[:2].tobytes() == alone.tobytes()
    # Where the network started anew nothing was predicted: the recall alone judges.
    anew = BOTH | dict(predicted_features=[0.0, 0.0])
    assert evaluate(system, "errors", anew, calibration) == pytest.approx([0.5, 2.0, 0.0])
    value, gradient = evaluate_autodiff(system, "errors", BOTH, "predicted_features")
    assert value == pytest.approx([0.05, 0.02, 0.08])
    assert gradient == pytest.approx(np.array([[0.0, 0.0], [0.0, 0.0], [-0.4, 0.0]]))  # 2 (f^R - f) / 2
    with pytest.raises(ValueError, match="mine recalls nothing: train recall heads"):
        DETECTORS["recall_innovation"].build(SimpleNamespace(**vars(SEEN), recalls=False, name="mine"), 2, {})


def test_the_fingers_are_not_judged():
    system = RecallDetector(SIZES, joints=1)
    assert evaluate(system, "errors", INPUTS, (MEANS, 1.0, 1.0)) == pytest.approx([0.1, 0.0])


def test_bits_are_those_of_the_formula():
    """The order of the operations decides the last bits, and with them every run that was ever recorded."""
    rng = np.random.default_rng(0)
    system = RecallDetector(SimpleNamespace(posture_size=8, horizon=10, state_size=1), joints=7)
    weights = np.append(np.ones(7), 0.0)
    for _ in range(20):
        history, recalled = rng.uniform(-1, 1, 96), rng.uniform(-1, 1, 88)
        means, beta, gamma = rng.uniform(1e-4, 1e-2, 11), rng.uniform(1, 30), rng.uniform(1, 900)
        factors = weights / weights.sum() / means[:, None]
        difference = np.delete(history, np.s_[8:16]) - recalled
        errors = ((difference * difference).reshape(11, 8) * factors).sum(axis=1)
        alpha = np.max(1.0 / (1.0 + np.exp(-np.clip(beta * (errors - gamma), -500.0, 500.0))))
        inputs = dict(posture_history=history, recalled_postures=recalled, hidden_state=[0.0])
        assert evaluate(system, "errors", inputs, (means, beta, gamma)).tobytes() == errors.tobytes()
        assert evaluate(system, "alpha", inputs, (means, beta, gamma))[0] == alpha


def calibrated(system, *calibration):
    context = system.CreateDefaultContext()
    system.set_calibration(context, *calibration)
    return context


def test_converts_and_takes_the_parameters_of_a_context_along():
    context = calibrated(SYSTEM, MEANS, 1.0, 1.0)
    alpha = 1.0 / (1.0 + np.exp(-1.0))
    value, gradient = evaluate_autodiff(SYSTEM, "alpha", INPUTS, "posture_history", context)
    assert value == pytest.approx([alpha])
    # d alpha / d m = alpha (1 - alpha) beta 2 (m - m^R) / (2 mean), in row 1 alone.
    assert gradient == pytest.approx(alpha * (1.0 - alpha) * np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.2 / 0.01]]))
    value, gradient = evaluate_autodiff(SYSTEM, "errors", INPUTS, "posture_history")
    assert value == pytest.approx([0.05, 0.02])  # the default parameters
    assert gradient == pytest.approx(np.array([[0.1, 0.3, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0.2]]))


@pytest.mark.parametrize(("size", "expected"), [(0.0, 0.0), (1e9, 1.0)])
@pytest.mark.filterwarnings("error")
def test_extreme_errors_are_safe_in_every_scalar_type(size, expected):
    calibration = MEANS, 30.0, 60.0
    inputs = INPUTS | dict(posture_history=np.full(6, size), recalled_postures=np.zeros(4))
    assert evaluate(SYSTEM, "alpha", inputs, calibration) == pytest.approx([expected], abs=1e-100)
    context = calibrated(SYSTEM, *calibration)
    value, gradient = evaluate_autodiff(SYSTEM, "alpha", inputs, "posture_history", context)
    assert value == pytest.approx([expected], abs=1e-100)
    assert np.all(np.isfinite(gradient))


@settings(max_examples=80, deadline=None)
@given(
    arrays(float, 6, elements=st.floats(-1e150, 1e150)),
    arrays(float, 4, elements=st.floats(-1e150, 1e150)),
    st.floats(1e-3, 1e3),
    st.floats(-1e3, 1e3),
)
def test_alpha_is_in_the_unit_interval_and_monotonic(posture, recalled, beta, gamma):
    inputs = dict(posture_history=posture, recalled_postures=recalled, hidden_state=np.zeros(3))
    alpha = evaluate(SYSTEM, "alpha", inputs, (MEANS, beta, gamma))[0]
    assert 0.0 <= alpha <= 1.0
    nearer = inputs | dict(recalled_postures=(np.delete(posture, [2, 3]) + recalled) / 2.0)
    assert evaluate(SYSTEM, "alpha", nearer, (MEANS, beta, gamma))[0] <= alpha + 1e-12
