"""OracleDetector: from the flag to the arm at home, and no tick longer."""

import numpy as np

from systems.oracle_detector import HOME, LONGEST, OracleDetector
from tests.systems.controller_fakes import FakePolicy
from tests.systems.system_checks import fix

POLICY = FakePolicy()


def alphas(steps):
    """alpha at each tick; a step is (active, how far the first joint is from home, of the tolerance)."""
    system = OracleDetector(POLICY, 3)
    context = system.CreateDefaultContext()
    found = []
    for active, away in steps:
        posture = POLICY.initial_posture.copy()
        posture[0] += away * HOME
        history = np.tile(POLICY.scaling.scale(posture), POLICY.horizon + 2)
        fix(system, context, dict(posture_history=history, active=[float(active)]))
        found.append(system.GetOutputPort("alpha").Eval(context)[0])
        assert system.GetOutputPort("errors").Eval(context)[0] == found[-1]
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    return found


def test_alpha_is_1_from_the_fault_to_the_arm_at_home():
    steps = [(0, 5), (1, 5), (1, 9), (0, 9), (0, 2), (0, 1.01), (0, 0.99), (0, 0.0), (0, 9)]
    # In the tick at home it is 1 still, so that the network starts anew there.
    assert alphas(steps) == [0, 1, 1, 1, 1, 1, 1, 0, 0]


def test_a_fault_at_home_is_over_with_it():
    assert alphas([(0, 0), (1, 0), (1, 0), (0, 0), (0, 5)]) == [0, 1, 1, 1, 0]


def test_a_fault_that_comes_again_is_noticed_again():
    assert alphas([(1, 9), (0, 9), (1, 9), (0, 0), (0, 9), (1, 9)]) == [1, 1, 1, 1, 0, 1]


def test_of_a_fault_that_never_ends_the_rest_is_not_told():
    found = alphas([(1, 9)] * LONGEST + [(1, 0)] + [(1, 9)] * 4)
    assert found == [1] * (LONGEST + 1) + [0] * 4  # one return, and at home it is over
    assert alphas([(1, 0)] * (LONGEST + 3) + [(0, 0), (1, 9)]) == [1] * (LONGEST + 1) + [0, 0, 0, 1]
