"""The LQR: hand-worked numbers, in float and AutoDiffXd; its contraction and cost to go."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from systems.posture_regulator import lqr, make_posture_regulator
from tests.systems.system_checks import evaluate, evaluate_autodiff


def test_lqr_by_hand():
    # s = q/2 (1 + sqrt(1 + 4 r/q)) = (1 + 19)/2 = 10; k = s/(r + s) = 0.1.
    K, S = lqr(3, 1.0, 90.0, 0.1)
    assert pytest.approx(0.1 * np.eye(3), abs=1e-9) == K
    assert pytest.approx(10.0 * np.eye(3), abs=1e-7) == S


def test_regulator_by_hand():
    initial = np.array([0.1, -0.2, 0.3, 0.04])
    regulator = make_posture_regulator(posture_size=4, joints=3, initial_posture=initial, Q=1.0, R=90.0, period=0.1)
    inputs = dict(u0=initial + np.array([1.0, -2.0, 0.0, 5.0]))
    assert evaluate(regulator, "y0", inputs) == pytest.approx([-0.1, 0.2, 0.0, 0.0], abs=1e-9)
    assert evaluate(regulator, "y0", dict(u0=initial)) == pytest.approx(np.zeros(4), abs=1e-15)
    value, gradient = evaluate_autodiff(regulator, "y0", inputs, "u0")
    assert value == pytest.approx([-0.1, 0.2, 0.0, 0.0], abs=1e-9)
    assert gradient == pytest.approx(np.diag([-0.1, -0.1, -0.1, 0.0]), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 8), st.floats(0.01, 100.0), st.floats(0.01, 1e4), arrays(float, 8, elements=st.floats(-3, 3)))
def test_lqr_contracts_and_its_cost_to_go_falls_by_the_stage_cost(joints, Q, R, deviation):
    K, S = lqr(joints, Q, R, 0.1)
    m = deviation[:joints]
    step = -K @ m
    after = m + step
    assert np.linalg.norm(after) <= np.linalg.norm(m)
    assert np.all(np.abs(np.linalg.eigvals(np.eye(joints) - K)) < 1.0)
    stage = Q * m @ m + R * step @ step
    assert m @ S @ m - after @ S @ after == pytest.approx(stage, rel=1e-6, abs=1e-12)


def test_lqr_takes_matrices():
    K, S = lqr(2, np.diag([1.0, 4.0]), np.diag([90.0, 90.0]), 0.1)
    s = 2.0 * (1.0 + np.sqrt(1.0 + 4.0 * 90.0 / 4.0))
    assert pytest.approx(np.diag([0.1, s / (90.0 + s)]), abs=1e-8) == K
    assert pytest.approx(np.diag([10.0, s]), rel=1e-6) == S


@pytest.mark.parametrize(("offset", "rests"), [(5.0, 50.0), (-0.3, -3.0)])
def test_a_constant_between_command_and_measurement_keeps_it_from_home_ten_times_as_far(offset, rests):
    """A sensor's offset, or a servo's sag: the step undoes it where K (m - m_init) is the offset."""
    initial = np.array([10.0, -20.0])
    regulator = make_posture_regulator(posture_size=2, joints=2, initial_posture=initial, Q=1.0, R=90.0, period=0.1)
    measured = initial.copy()
    for _ in range(300):
        step = evaluate(regulator, "y0", dict(u0=measured))
        measured = measured + step + [offset, 0.0]
    assert measured == pytest.approx(initial + [rests, 0.0])
