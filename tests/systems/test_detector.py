"""What detectors share: the calibration in the Context, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.detector import check_detector
from systems.loop_closer import LoopCloser
from systems.recall_detector import RecallDetector
from tests.systems.controller_fakes import PERIOD, FakePolicy, image, make_controller
from tests.systems.outside_detector import FarFromHome
from tests.systems.system_checks import fix

SIZES = SimpleNamespace(posture_size=2, horizon=1, state_size=3)
INPUTS = dict(
    posture_history=[0.1, 0.3, 9.0, 9.0, 0.5, 0.7], recalled_postures=[0.0, 0.0, 0.5, 0.5], hidden_state=[0.0, 0.0, 0.0]
)


def test_a_calibration_holds_at_once_and_in_clones():
    system = RecallDetector(SIZES, joints=2)
    context = system.CreateDefaultContext()
    fix(system, context, INPUTS)
    alpha = system.GetOutputPort("alpha")
    assert alpha.Eval(context)[0] < 1e-200
    system.set_calibration(context, [0.1, 0.01], 2.0, 2.0)  # l / mean = (0.5, 2)
    assert alpha.Eval(context)[0] == pytest.approx(0.5)
    clone = context.Clone()
    system.set_calibration(context, [0.1, 0.01], 2.0, 3.0)
    assert alpha.Eval(context)[0] == pytest.approx(1.0 / (1.0 + np.exp(2.0)))
    assert alpha.Eval(clone)[0] == pytest.approx(0.5)


def test_one_controller_serves_every_calibration():
    policy = FakePolicy(nonsense=0.1)  # at tick 1 l_0 = 0.0001, l_1 = l_2 = 0.01
    controller = make_controller(policy=policy)
    alphas, contexts = {}, {gamma: controller.CreateDefaultContext() for gamma in (99.0, 100.0, 101.0)}
    for gamma, context in contexts.items():
        controller.set_calibration(context, np.full(3, 1e-4), 2.0, gamma)
    for gamma, context in contexts.items():
        fix(controller, context, dict(rgb_image=image(), posture=policy.initial_posture))
        Simulator(controller, context).AdvanceTo(1.5 * PERIOD)
        alphas[gamma] = controller.GetOutputPort("alpha").Eval(context)[0]
        clone = context.Clone()
        assert controller.GetOutputPort("alpha").Eval(clone)[0] == alphas[gamma]
    assert list(alphas.values()) == pytest.approx([1 / (1 + np.exp(-2.0)), 0.5, 1 / (1 + np.exp(2.0))])


@pytest.mark.parametrize(
    ("calibration", "message"),
    [
        ((np.zeros(2), 30.0, 60.0), "mean_errors is .*greater than 0.*calibrate"),
        ((np.ones(3), 30.0, 60.0), r"mean_errors has shape \(3,\).*\(2,\)"),
        ((np.ones(2), -1.0, 60.0), "beta is -1.0.*greater than 0"),
        ((np.ones(2), 30.0, np.inf), "gamma is .*inf.*finite"),
    ],
)
def test_a_bad_calibration_is_refused_and_changes_nothing(calibration, message):
    system = RecallDetector(SIZES, joints=2)
    context = system.CreateDefaultContext()
    fix(system, context, INPUTS)
    with pytest.raises(ValueError, match=f"(?s){message}"):
        system.set_calibration(context, *calibration)
    assert system.GetOutputPort("errors").Eval(context) == pytest.approx([0.05, 0.02])


def test_a_system_that_is_no_detector_is_refused():
    detector = RecallDetector(SIZES, joints=2)
    check_detector(detector, SIZES)
    with pytest.raises(ValueError, match=r"`posture_history` of .* has size 6, the policy asks for 8"):
        check_detector(detector, SimpleNamespace(posture_size=2, horizon=2, state_size=3))
    with pytest.raises(ValueError, match=r"LoopCloser.* no port `posture_history`"):
        check_detector(LoopCloser(posture_size=2, feature_size=2), SIZES)

    class Fixed(FarFromHome):
        set_calibration = property()

    policy = FakePolicy()
    with pytest.raises(ValueError, match=r"Fixed has no method `set_calibration`: derive it from CalibratedDetector"):
        make_controller(policy=policy, detector=Fixed(policy))
