"""The Lyapunov function of mode return: hand-worked levels and rates."""

import numpy as np
import pytest

from diagrams.hybrid.lyapunov import SAFETY_FACTOR, Lyapunov

UNITS = np.array([0.7, 0.5, 0.3, 0.7, 0.3, 0.5, 0.3])


@pytest.fixture(scope="module")
def lyapunov(world):
    return Lyapunov.of(world, UNITS)


def test_riccati_by_hand(lyapunov):
    """Scalar: S^2 = q (S + r), q = 1, r = 90: S = 10, K = 10 / 100; V falls by (1 + 0.01 * 90) / 10 of itself."""
    assert np.diag(lyapunov.P) == pytest.approx(10.0 / UNITS**2, rel=1e-8)
    assert lyapunov.gain == pytest.approx(0.1 * np.eye(7), abs=1e-8)
    assert lyapunov.rate == pytest.approx(0.81, abs=1e-8)
    assert lyapunov.rate_with(0.0) == pytest.approx(0.81, abs=1e-8)
    # |m+| <= (0.9 + 0.5 * 0.1) |m|
    assert lyapunov.rate_with(0.5) == pytest.approx(0.95**2, abs=1e-8)
    assert lyapunov.value(UNITS) == pytest.approx(70.0)


def test_levels_by_hand(lyapunov):
    # Joint 3 reaches 0.3 rad on the level 10.
    assert lyapunov.level_within(np.eye(7), UNITS) == pytest.approx(10.0)
    assert lyapunov.level_within(np.eye(7), np.append(np.full(6, 9.0), 0.15)) == pytest.approx(2.5)
    # A step of 0.1 d within 0.07 rad: d within 0.7.
    assert lyapunov.level_within(lyapunov.gain, np.full(7, 0.07)) == pytest.approx(10.0)


def test_tracking_error_by_hand(lyapunov):
    home = np.zeros(7)
    ideal = np.array([0.9**k * UNITS for k in range(4)])
    assert lyapunov.relative_error(ideal, home) == pytest.approx(0.0, abs=1e-7)
    late = ideal.copy()
    late[1] = 0.92 * UNITS  # a fifth of the step is missing
    assert lyapunov.relative_error(late, home)[0] == pytest.approx(0.2)


def test_servo_level_is_where_contraction_ends(lyapunov):
    enough = 1.0 / SAFETY_FACTOR  # of the error leaves 0.9 + 0.1
    etas = np.array([0.1, 1.001 * enough, 0.999 * enough, 2.0])
    assert lyapunov.servo_level(np.array([1.0, 3.0, 2.0, 4.0]), etas) == 3.0
    assert lyapunov.servo_level(np.array([1.0]), np.array([0.1])) == np.inf


def test_samples_are_uniform_in_the_set(lyapunov):
    values = lyapunov.value(lyapunov.sample_inside(np.random.default_rng(0), 2.0, 4000))
    assert values.max() <= 2.0
    # In 7 dimensions the share below half the level is 2^-3.5.
    assert np.mean(values < 1.0) == pytest.approx(2**-3.5, abs=0.012)
