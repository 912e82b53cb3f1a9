"""SwitchingLaw converts whole to AutoDiffXd and Expression, and computes the same."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import Diagram_, LeafSystem

from systems.detector import declare_detector_inputs
from tests.systems.controller_fakes import FakePolicy, make_controller
from tests.systems.system_checks import evaluate, evaluate_autodiff, evaluate_symbolic

OUTPUTS = ("network_input", "errors", "alpha", "desired_posture", "rnn_step", "regulator_step", "step")


def law_and_inputs(joints):
    policy = FakePolicy(joints=joints)
    controller = make_controller(policy=policy, speed_limits=np.full(joints + 1, 1.0))
    law = controller.GetSubsystemByName("switching_law")
    rng = np.random.default_rng(joints)
    inputs = {
        law.get_input_port(i).get_name(): rng.uniform(-0.5, 0.5, law.get_input_port(i).size())
        for i in range(law.num_input_ports())
    }
    # Errors near gamma times their mean, where alpha is neither 0 nor 1.
    inputs["recalled_postures"] = (
        inputs["posture_history"] + 0.0774 + 1e-4 * rng.normal(size=len(inputs["posture_history"]))
    )
    return law, inputs


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("output", OUTPUTS)
def test_conversions_compute_the_same(joints, output):
    law, inputs = law_and_inputs(joints)
    expected = evaluate(law, output, inputs)
    value, _ = evaluate_autodiff(law, output, inputs, "sampled_posture")
    assert value == pytest.approx(expected, rel=1e-12, abs=1e-14)
    assert evaluate_symbolic(law, output, inputs) == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_converted_types():
    law, _ = law_and_inputs(3)
    assert isinstance(law.ToAutoDiffXd(), Diagram_[AutoDiffXd])
    assert isinstance(law.ToSymbolic(), Diagram_[Expression])


@pytest.mark.parametrize("with_respect_to", ["recalled_postures", "sampled_posture", "predicted_posture"])
def test_gradient_is_that_of_finite_differences(with_respect_to):
    law, inputs = law_and_inputs(3)
    assert 0.01 < evaluate(law, "alpha", inputs)[0] < 0.99
    _, gradient = evaluate_autodiff(law, "desired_posture", inputs, with_respect_to)
    h = 1e-7
    differences = []
    for unit in np.eye(len(inputs[with_respect_to])):
        above, below = (
            evaluate(law, "desired_posture", inputs | {with_respect_to: inputs[with_respect_to] + s * h * unit})
            for s in (1.0, -1.0)
        )
        differences.append((above - below) / (2.0 * h))
    assert gradient == pytest.approx(np.array(differences).T, rel=1e-5, abs=1e-6)


class FarFromHome(LeafSystem):
    """A detector in a few lines: how far the first joint is; as a user would write it."""

    def __init__(self, **sizes):
        super().__init__()
        self._posture_history, *_ = declare_detector_inputs(self, **sizes)
        self.DeclareVectorOutputPort("errors", 1, self._errors, {self._posture_history.ticket()})
        self.DeclareVectorOutputPort("alpha", 1, self._errors, {self._posture_history.ticket()})

    def _errors(self, context, output):
        output[0] = min(abs(self._posture_history.Eval(context)[0]), 1.0)


def test_another_detector_takes_the_place():
    policy = FakePolicy()
    detector = FarFromHome(posture_size=4, horizon=2, state_size=policy.state_size)
    policy.reference_errors = None  # not needed then
    controller = make_controller(policy=policy, detector=detector)
    context = controller.CreateDefaultContext()
    expected = abs(policy.scaling.scale(policy.initial_posture)[0])
    assert controller.GetOutputPort("alpha").Eval(context) == pytest.approx([expected])
    assert controller.GetOutputPort("errors").size() == 1
