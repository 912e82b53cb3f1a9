"""EnsembleDetector: hand-worked variance, others that are fed alike, files of several networks."""

import numpy as np
import pytest

from models.errors import InputError
from systems.ensemble_detector import EnsembleDetector
from tests.systems.controller_fakes import ClosedLoop, FakePolicy, TickArm, make_controller
from tests.systems.system_checks import fix


def test_variance_by_hand():
    """Two others that go on by 0.1 and 0.4 a tick; the one that acts said 0.1: variance of (0.1, 0.1, 0.4) is 0.02."""
    policy, others = FakePolicy(), [FakePolicy(drift=0.1), FakePolicy(drift=0.4)]
    system = EnsembleDetector(policy, 3, others)
    context = system.CreateDefaultContext()
    home, size = policy.scaling.scale(policy.initial_posture), policy.posture_size
    given = dict(
        recalled_postures=np.tile(home, 3), predicted_features=np.zeros(4), network_input=np.zeros(8), reset=[0.0]
    )
    fix(system, context, given)
    agreed = pytest.approx([0.0, 0.0], abs=1e-30)
    assert system.GetOutputPort("errors").Eval(context) == agreed  # before the first tick
    x = np.concatenate((np.zeros(size), [0.4, 0.0, 0.0, 0.8]))
    fix(system, context, dict(network_input=x))
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    own = np.append(np.full(3, 0.1), 9.0)  # the fingers are not judged
    fix(system, context, dict(recalled_postures=np.tile(own, 3), predicted_features=[0.2, 0.0, 0.0, 0.1]))
    # Features: the others said half of x; (0.1, 0.4, 0.4) at the last one has variance 0.02.
    assert system.GetOutputPort("errors").Eval(context) == pytest.approx([0.02, 0.02 / 4])
    fix(system, context, dict(reset=[1.0]))
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    fix(system, context, given)
    assert system.GetOutputPort("errors").Eval(context) == agreed  # all started anew


def test_in_the_loop_the_others_are_fed_as_the_network_is():
    policy, other = FakePolicy(), FakePolicy(drift=0.05)
    detector = EnsembleDetector(policy, 3, [other])
    arm = TickArm(policy.initial_posture)
    loop = ClosedLoop(make_controller(policy=policy, detector=detector), arm, ([1.0, 1.0], 1.0, 1e12))
    loop.after_tick(5)
    assert len(other.inputs) == len(policy.inputs) == 6
    for theirs, own in zip(other.inputs, policy.inputs, strict=True):
        assert theirs.tobytes() == own.tobytes()
    # Of two predictions 0.04 apart the variance is 0.02^2.
    assert loop.output("errors") == pytest.approx([0.02**2, 0.0])


def test_an_ensemble_of_one_is_refused():
    with pytest.raises(InputError, match="two networks of a kind"):
        EnsembleDetector.fit([b"one"])
    with pytest.raises(ValueError, match="another network has the sizes"):
        EnsembleDetector(FakePolicy(), 3, [FakePolicy(joints=2)])
