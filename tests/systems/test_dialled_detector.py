"""DialledDetector: its own gamma until another one is given, then Eqs. 5 and 6 with that."""

import math

import numpy as np
import pytest

from systems.dialled_detector import DialledDetector
from systems.recall_detector import RecallDetector
from tests.systems.controller_fakes import FakePolicy, make_controller
from tests.systems.system_checks import evaluate

MEANS, BETA, GAMMA = [1e-3, 1e-3, 1e-3], 2.0, 8.0


def inputs(policy, error):
    """The prediction is `error` (rad, scaled) off at each joint."""
    size, horizon = policy.posture_size, policy.horizon
    recalled = np.zeros((horizon + 1) * size)
    recalled[:size] = error
    history = np.zeros((horizon + 2) * size)
    return {"posture_history": history, "recalled_postures": recalled, "hidden_state": np.zeros(policy.state_size)}


def test_its_own_gamma_gives_the_same_bits_and_another_one_the_formula():
    policy = FakePolicy()
    given = inputs(policy, 0.1)  # l_0 / mean = 0.01 / 0.001 = 10
    plain = evaluate(RecallDetector.build(policy, 3, {}), "alpha", given, (MEANS, BETA, GAMMA))
    for gamma, expected in ((math.nan, plain[0]), (9.5, 1 / (1 + math.exp(-2 * 0.5))), (20.0, 1 / (1 + math.exp(20)))):
        dialled = DialledDetector(RecallDetector.build(policy, 3, {}))
        found = evaluate(dialled, "alpha", given | {"gamma": [gamma]}, (MEANS, BETA, GAMMA))
        assert found[0] == (expected if math.isnan(gamma) else pytest.approx(expected, rel=1e-9))


def test_the_controller_has_the_port_where_the_detector_has_it():
    assert not make_controller().HasInputPort("gamma")
    dialled = DialledDetector(RecallDetector.build(FakePolicy(), 3, {}))
    assert make_controller(detector=dialled).HasInputPort("gamma")
