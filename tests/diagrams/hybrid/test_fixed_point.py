"""Newton's method and decay, on maps that are known."""

import numpy as np
import pytest

from diagrams.hybrid.fixed_point import measure_decay, nearest_fixed_point, newton


def test_newton_finds_the_root():
    """x+ = cos x has one fixed point, 0.7390851332151607."""
    found = newton(np.cos, lambda z: -np.diag(np.sin(z)), np.array([3.0]))
    assert found.converged
    assert found.z[0] == pytest.approx(0.7390851332151607, abs=1e-12)


def test_where_there_is_no_fixed_point_it_is_said():
    """x+ = x + x^2 + 0.01 moves on everywhere, most slowly at 0."""
    found = newton(lambda z: z + z**2 + 0.01, lambda z: np.diag(1 + 2 * z), np.array([1.0]))
    assert not found.converged
    assert found.residual == pytest.approx(0.01, rel=0.1)


def test_the_nearest_of_several_is_taken():
    """x+ = x - sin(x) / 2: attracting at 0, repelling at pi."""
    step, jacobian = lambda z: z - np.sin(z) / 2, lambda z: np.diag(1 - np.cos(z) / 2)
    assert nearest_fixed_point(step, jacobian, np.array([0.4]), 1).z[0] == pytest.approx(0.0, abs=1e-9)
    assert nearest_fixed_point(step, jacobian, np.array([3.0]), 1).z[0] == pytest.approx(np.pi, abs=1e-9)


@pytest.mark.parametrize("radius", [0.6, 0.95, 1.08])
def test_decay_of_a_rotation(radius):
    """A turn by 20 deg a tick that shrinks (or grows) by `radius`, beside something faster."""
    angle = np.deg2rad(20.0)
    A = np.zeros((3, 3))
    A[:2, :2] = radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A[2, 2] = 0.3 * radius
    measured, norms = measure_decay(lambda z: A @ z, np.zeros(3), radius, np.random.default_rng(0))
    assert measured == pytest.approx(radius, rel=1e-3)
    assert norms[0] == pytest.approx(1e-5)
