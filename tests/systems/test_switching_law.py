"""SwitchingLaw converts whole to AutoDiffXd, and computes the same."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import Diagram_

from tests.systems.controller_fakes import FakePolicy, make_controller
from tests.systems.system_checks import evaluate_autodiff, fix

OUTPUTS = ("network_input", "errors", "alpha", "desired_posture", "rnn_step", "regulator_step")


def law_context_and_inputs(joints):
    policy = FakePolicy(joints=joints)
    controller = make_controller(policy=policy, speed_limits=np.full(joints + 1, 1.0))
    root = controller.CreateDefaultContext()
    controller.set_calibration(root, *policy.calibration)
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
    context = law.CreateDefaultContext()
    context.SetTimeStateAndParametersFrom(law.GetMyContextFromRoot(root))
    return law, context, inputs


def evaluate(law, context, output, inputs):
    fix(law, context, inputs)
    return law.GetOutputPort(output).Eval(context).copy()


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("output", OUTPUTS)
def test_conversion_computes_the_same(joints, output):
    law, context, inputs = law_context_and_inputs(joints)
    assert isinstance(law.ToAutoDiffXd(), Diagram_[AutoDiffXd])
    expected = evaluate(law, context, output, inputs)
    value, _ = evaluate_autodiff(law, output, inputs, "sampled_posture", context)
    assert value == pytest.approx(expected, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("with_respect_to", ["recalled_postures", "sampled_posture", "predicted_posture"])
def test_gradient_is_that_of_finite_differences(with_respect_to):
    law, context, inputs = law_context_and_inputs(3)
    assert 0.01 < evaluate(law, context, "alpha", inputs)[0] < 0.99
    _, gradient = evaluate_autodiff(law, "desired_posture", inputs, with_respect_to, context)
    h = 1e-7
    differences = []
    for unit in np.eye(len(inputs[with_respect_to])):
        above, below = (
            evaluate(
                law, context, "desired_posture", inputs | {with_respect_to: inputs[with_respect_to] + s * h * unit}
            )
            for s in (1.0, -1.0)
        )
        differences.append((above - below) / (2.0 * h))
    assert gradient == pytest.approx(np.array(differences).T, rel=1e-5, abs=1e-6)
