"""Innovations, their cumulative sum, speed and reversals: hand-worked numbers, derivatives, what has no prediction."""

from types import SimpleNamespace

import numpy as np
import pytest

from models.data.runs import Tape
from models.data.scaling import MinMaxScaling
from systems.cusum_detector import DRIFT, CusumDetector
from systems.detectors import DETECTORS
from systems.innovation_detector import InnovationDetector
from systems.reversals_detector import ReversalsDetector
from systems.speed_detector import SpeedDetector
from tests.systems.system_checks import evaluate, evaluate_autodiff, fix

# Scaled units are 2 and 4 rad, and 1 m.
POLICY = SimpleNamespace(
    posture_size=3, horizon=2, state_size=1, feature_size=2, scaling=MinMaxScaling([-2, -4, -1], [2, 4, 1])
)
# m_k = (0.1, 0.3), m^R_k = (0.0, 0.1): mean square (0.01 + 0.04) / 2; features (0.6 - 0.2)^2 / 2.
INPUTS = dict(
    posture_history=np.ravel([[0.1, 0.3, 9.0], [0.0, 0.3, 9.0], [0.0, 0.1, 9.0], [0.2, 0.1, 9.0]]),
    recalled_postures=np.ravel([[0.0, 0.1, 5.0], [7.0] * 3, [7.0] * 3]),
    hidden_state=[3.0],
    features=[0.6, 0.5],
    predicted_features=[0.2, 0.5],
)
POSTURE, FEATURES = 0.025, 0.08
THREE = ("posture_history", "recalled_postures", "hidden_state")
CHEAP = {name: INPUTS[name] for name in THREE}


def test_innovations_by_hand():
    system = InnovationDetector(POLICY, joints=2)
    assert evaluate(system, "errors", INPUTS) == pytest.approx([POSTURE, FEATURES])
    calibration = [0.01, 0.01], 2.0, 7.0
    assert evaluate(system, "errors", INPUTS, calibration) == pytest.approx([2.5, 8.0])
    assert evaluate(system, "alpha", INPUTS, calibration) == pytest.approx([1.0 / (1.0 + np.exp(-2.0))])


@pytest.mark.parametrize(
    ("name", "error", "inputs"),
    [
        ("innovation_posture", POSTURE, THREE),
        ("innovation_features", FEATURES, (*THREE, "features", "predicted_features")),
    ],
)
def test_each_innovation_alone(name, error, inputs):
    system = DETECTORS[name].build(POLICY, 2, DETECTORS[name].fit([]))
    ports = [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]
    assert tuple(ports) == inputs
    assert evaluate(system, "errors", {port: INPUTS[port] for port in ports}) == pytest.approx([error])


def test_features_of_which_nothing_was_predicted_have_no_error():
    """Else an arm at home whose network starts anew, tick after tick, would never be given back."""
    nothing = INPUTS | dict(predicted_features=[0.0, 0.0])
    assert evaluate(InnovationDetector(POLICY, joints=2), "errors", nothing) == pytest.approx([POSTURE, 0.0])


def test_innovations_convert():
    system = InnovationDetector(POLICY, joints=2)
    value, gradient = evaluate_autodiff(system, "errors", INPUTS, "predicted_features")
    assert value == pytest.approx([POSTURE, FEATURES])
    assert gradient == pytest.approx(np.array([[0.0, 0.0], [-0.4, 0.0]]))  # 2 (f^R - f) / 2
    _, gradient = evaluate_autodiff(system, "errors", INPUTS, "recalled_postures")
    assert gradient[0, :3] == pytest.approx([-0.1, -0.2, 0.0])


def cusum_after(reference, inputs):
    """S after each of the sets of inputs, read before its update."""
    system = CusumDetector(POLICY, 2, reference)
    context, found = system.CreateDefaultContext(), []
    for values in inputs:
        fix(system, context, INPUTS | values)
        found.append(system.GetOutputPort("errors").Eval(context).copy())
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    return np.array(found)


def test_cusum_by_hand():
    # l / r is 5 and 1 a tick, the allowance 2: posture gains 3, features never leave 0.
    found = cusum_after([POSTURE / 5.0, FEATURES], [{"reset": [0.0]}] * 3)
    assert DRIFT == 2.0
    assert found == pytest.approx(np.array([[3.0, 0.0], [6.0, 0.0], [9.0, 0.0]]))
    fits = dict(recalled_postures=INPUTS["posture_history"][:9])  # the prediction is right: 2 less a tick, not below 0
    steps = [{}, fits, fits, fits, {}]
    found = cusum_after([POSTURE / 5.0, FEATURES], [{"reset": [0.0]} | step for step in steps])
    assert found[:, 0] == pytest.approx([3.0, 1.0, 0.0, 0.0, 3.0])


def test_cusum_begins_anew_where_the_network_does():
    found = cusum_after([POSTURE / 5.0, FEATURES], [{"reset": [float(k == 1)]} for k in range(4)])
    assert found[:, 0] == pytest.approx([3.0, 6.0, 3.0, 6.0])


def test_cusum_learns_the_means_of_normal_runs():
    rng = np.random.default_rng(0)
    posture, recalled = rng.normal(size=(2, 50, 3))
    features, predicted = rng.normal(size=(2, 50, 2))
    recalled = np.repeat(recalled[:, None], 3, axis=1)
    predicted[0] = 0.0  # not a prediction
    tape = Tape(posture, recalled, np.zeros((50, 1)), features, predicted, np.zeros(50))
    arrays = CusumDetector.fit([tape])
    assert arrays["reference"][:3] == pytest.approx(((posture - recalled[:, 0]) ** 2).mean(axis=0))
    assert arrays["reference"][3] == pytest.approx(((features - predicted)[1:] ** 2).mean())
    arrays = {"reference": np.array([POSTURE / 10.0, 3.0 * POSTURE / 10.0, 77.0, FEATURES])}  # of joints on average /5
    system = CusumDetector.build(POLICY, 2, arrays)
    assert evaluate(system, "errors", INPUTS) == pytest.approx([3.0, 0.0])


def test_speed_by_hand():
    # 0.1 of 2 rad in 0.1 s.
    assert evaluate(SpeedDetector(POLICY, 2), "errors", CHEAP) == pytest.approx([4.0])
    slower = SimpleNamespace(**vars(POLICY), metadata={"world": {"period": 0.2}})
    assert evaluate(SpeedDetector(slower, 2), "errors", CHEAP) == pytest.approx([1.0])
    _, gradient = evaluate_autodiff(SpeedDetector(POLICY, 2), "errors", CHEAP, "posture_history")
    assert gradient[0, :4] == pytest.approx([80.0, 0.0, 0.0, -80.0])


def test_reversals_by_hand():
    # Steps in rad, newest first: (0.2, 0), (0, 0.8), (-0.4, 0): no two against each other.
    assert evaluate(ReversalsDetector(POLICY, 2), "errors", CHEAP) == pytest.approx([0.0])
    rows = [[0.1, 0.0, 9.0], [0.0, 0.1, 0.0], [0.1, 0.0, 9.0], [0.1, 0.0, 9.0]]
    turned = CHEAP | dict(posture_history=np.ravel(rows))
    # Steps (0.2, -0.4), (-0.2, 0.4), (0, 0): one reversal, of 0.04 + 0.16.
    assert evaluate(ReversalsDetector(POLICY, 2), "errors", turned) == pytest.approx([0.2])
    value, gradient = evaluate_autodiff(ReversalsDetector(POLICY, 2), "errors", turned, "posture_history")
    assert value == pytest.approx([0.2])
    assert gradient[0, :2] == pytest.approx([0.2 * 2.0, -0.4 * 4.0])  # minus the step before, in its unit
