"""LoopCloser: hand-worked numbers, in float and AutoDiffXd."""

import numpy as np
import pytest

from systems.loop_closer import LoopCloser
from tests.systems.system_checks import evaluate, evaluate_autodiff

CLOSER = LoopCloser(posture_size=2, feature_size=1)
CLOSER_INPUTS = dict(
    posture=[1.0, 2.0], features=[0.5], predicted_posture=[0.0, 4.0], predicted_features=[-0.5], alpha=[0.25]
)


def test_loop_closer_by_hand():
    assert evaluate(CLOSER, "network_input", CLOSER_INPUTS) == pytest.approx([0.75, 2.5, 0.25])
    assert np.array_equal(evaluate(CLOSER, "network_input", CLOSER_INPUTS | dict(alpha=[0.0])), [1.0, 2.0, 0.5])
    assert np.array_equal(evaluate(CLOSER, "network_input", CLOSER_INPUTS | dict(alpha=[1.0])), [0.0, 4.0, -0.5])


def test_what_is_measured_is_left_alone_where_alpha_is_one():
    unconnected = {name: value for name, value in CLOSER_INPUTS.items() if name not in ("posture", "features")}
    assert np.array_equal(evaluate(CLOSER, "network_input", unconnected | dict(alpha=[1.0])), [0.0, 4.0, -0.5])
    with pytest.raises(RuntimeError, match="not connected"):
        evaluate(CLOSER, "network_input", unconnected | dict(alpha=[np.nextafter(1.0, 0.0)]))


def test_loop_closer_keeps_its_derivative_where_alpha_is_one():
    value, gradient = evaluate_autodiff(CLOSER, "network_input", CLOSER_INPUTS | dict(alpha=[1.0]), "alpha")
    assert value == pytest.approx([0.0, 4.0, -0.5])
    assert gradient.ravel() == pytest.approx([-1.0, 2.0, -1.0])


def test_loop_closer_converts():
    value, gradient = evaluate_autodiff(CLOSER, "network_input", CLOSER_INPUTS, "alpha")
    assert value == pytest.approx([0.75, 2.5, 0.25])
    assert gradient.ravel() == pytest.approx([-1.0, 2.0, -1.0])  # predicted - measured
