"""RecallDetector: hand-worked numbers, alpha in [0, 1] for any errors, conversion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.detector import RecallDetector
from tests.systems.system_checks import evaluate, evaluate_autodiff, evaluate_symbolic

# Two ticks of two components; l = [(0.1^2 + 0.3^2)/2, 0.2^2/2] = [0.05, 0.02].
INPUTS = dict(
    posture_history=[0.1, 0.3, 0.5, 0.7], recalled_postures=[0.0, 0.0, 0.5, 0.5], hidden_state=[0.0, 0.0, 0.0]
)


def detector(**changes):
    arguments = dict(posture_size=2, horizon=1, state_size=3, reference_errors=[0.1, 0.01], beta=1.0, gamma=1.0)
    return RecallDetector(**(arguments | changes))


def test_by_hand():
    assert evaluate(detector(), "errors", INPUTS) == pytest.approx([0.5, 2.0])
    assert evaluate(detector(), "alpha", INPUTS) == pytest.approx([1.0 / (1.0 + np.exp(-1.0))])  # of row 1, the larger
    assert evaluate(detector(beta=3.0, gamma=3.0), "alpha", INPUTS) == pytest.approx([1.0 / (1.0 + np.exp(3.0))])


def test_weights_leave_the_finger_out():
    assert evaluate(detector(component_weights=[1.0, 0.0]), "errors", INPUTS) == pytest.approx([0.1, 0.0])
    assert evaluate(detector(component_weights=[2.0, 2.0]), "errors", INPUTS) == pytest.approx([0.5, 2.0])
    assert evaluate(detector(component_weights=[1.0, 3.0]), "errors", INPUTS) == pytest.approx([0.7, 3.0])


def test_converts():
    alpha = 1.0 / (1.0 + np.exp(-1.0))
    value, gradient = evaluate_autodiff(detector(), "alpha", INPUTS, "posture_history")
    assert value == pytest.approx([alpha])
    # d alpha / d m = alpha (1 - alpha) beta 2 (m - m^R) / (2 mean), in row 1 alone.
    assert gradient == pytest.approx(alpha * (1.0 - alpha) * np.array([[0.0, 0.0, 0.0, 0.2 / 0.01]]))
    assert evaluate_symbolic(detector(), "alpha", INPUTS) == pytest.approx([alpha])
    assert evaluate_symbolic(detector(), "errors", INPUTS) == pytest.approx([0.5, 2.0])


@pytest.mark.parametrize(("size", "expected"), [(0.0, 0.0), (1e9, 1.0)])
@pytest.mark.filterwarnings("error")
def test_extreme_errors_are_safe_in_every_scalar_type(size, expected):
    system = detector(beta=30.0, gamma=60.0)
    inputs = INPUTS | dict(posture_history=np.full(4, size), recalled_postures=np.zeros(4))
    assert evaluate(system, "alpha", inputs) == pytest.approx([expected], abs=1e-100)
    value, gradient = evaluate_autodiff(system, "alpha", inputs, "posture_history")
    assert value == pytest.approx([expected], abs=1e-100)
    assert np.all(np.isfinite(gradient))
    assert evaluate_symbolic(system, "alpha", inputs) == pytest.approx([expected], abs=1e-100)


@settings(max_examples=80, deadline=None)
@given(
    arrays(float, 4, elements=st.floats(-1e150, 1e150)),
    arrays(float, 4, elements=st.floats(-1e150, 1e150)),
    st.floats(1e-3, 1e3),
    st.floats(-1e3, 1e3),
)
def test_alpha_is_in_the_unit_interval_and_monotonic(posture, recalled, beta, gamma):
    system = detector(beta=beta, gamma=gamma)
    inputs = dict(posture_history=posture, recalled_postures=recalled, hidden_state=np.zeros(3))
    alpha = evaluate(system, "alpha", inputs)[0]
    assert 0.0 <= alpha <= 1.0
    nearer = inputs | dict(recalled_postures=(posture + recalled) / 2.0)
    assert evaluate(system, "alpha", nearer)[0] <= alpha + 1e-12
