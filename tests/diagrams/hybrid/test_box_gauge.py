"""The gauge of the box: hand-worked values and rates; what holds wherever the arm is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diagrams.hybrid.box_gauge import BoxGauge, scalar_gain
from diagrams.world.station import controller_limits
from models.errors import InputError

# Joint 1 reaches farther than its step allows; joint 4 is near its upper limit.
GAUGE = BoxGauge(
    down=np.array([3.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0]), up=np.array([2.0, 1.0, 2.0, 0.5, 2.0, 0.4, 2.0]),
    gain=0.1, max_step=np.array([0.24, 0.2, 0.3, 0.3, 0.3, 0.3, 0.3]), first_step=np.full(7, 0.15), core=0.0,
)  # fmt: skip
DEVIATIONS = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(
    lambda shares: np.where(np.array(shares) > 0, np.array(shares) * GAUGE.up, np.array(shares) * GAUGE.down)
)


def ideal_step(gauge, deviation):
    """(7,) rad: what the regulator commands, within the limits of speed."""
    return np.clip(-gauge.gain * deviation, -gauge.max_step, gauge.max_step)


def deviation(**joints):
    d = np.zeros(7)
    for name, value in joints.items():
        d[int(name[1]) - 1] = value
    return d


def test_values_by_hand():
    assert GAUGE.value(deviation(j4=0.25)) == pytest.approx(0.5)
    assert GAUGE.value(deviation(j4=-0.25)) == pytest.approx(0.125)
    assert GAUGE.value(deviation(j1=-1.5, j4=0.25, j7=1.2)) == pytest.approx(0.6)
    assert GAUGE.value(np.array([GAUGE.up, -GAUGE.down, 2 * GAUGE.up])) == pytest.approx([1.0, 1.0, 2.0])
    assert GAUGE.level_within(0.03) == pytest.approx(0.01)  # joint 1 reaches 3 rad
    assert GAUGE.value(np.zeros(7)) == 0.0


def test_the_core_counts_as_home():
    gauge = replace(GAUGE, core=0.1)
    assert gauge.value(np.full(7, -0.1)) == 0.0
    assert gauge.value(deviation(j4=0.3)) == pytest.approx(0.2 / 0.4)
    assert gauge.value(np.array([gauge.up, -gauge.down])) == pytest.approx([1.0, 1.0])
    assert gauge.level_within(0.39) == pytest.approx(0.1)


def test_first_rates_by_hand():
    # Cut, joint 1 goes 0.15 of 3 rad, joint 3 the same of 2 rad; not cut, a tenth.
    assert GAUGE.first_rate(deviation(j1=-3.0)) == pytest.approx(0.95)
    assert GAUGE.first_rate(deviation(j3=2.0)) == pytest.approx(0.925)
    assert GAUGE.first_rate(deviation(j4=0.5)) == pytest.approx(0.9)
    # Joint 4 is farthest by its reach, of which joint 3's slow start takes nothing; then it is joint 3.
    assert GAUGE.first_rate(deviation(j3=1.8, j4=0.5)) == pytest.approx(0.9)
    assert GAUGE.first_rate(deviation(j3=1.99, j4=0.5)) == pytest.approx(0.92)
    assert GAUGE.first_rate(np.zeros((2, 7))) == pytest.approx([0.9, 0.9])
    core = replace(GAUGE, core=0.1)  # what is left falls by more than a tenth: no less than that is promised
    assert core.first_rate(deviation(j4=0.3)) == pytest.approx(0.9)


@given(DEVIATIONS, st.sampled_from([0.0, 0.05]))
def test_no_first_rate_is_above_that_of_the_farthest(d, core):
    """Each joint shrinks by 1 - first_step_j / |d_j| or by 1 - k: the slowest of them, from its own reach, bounds V."""
    gauge = replace(GAUGE, core=core)
    slowest = np.max(np.maximum(0.9, 1.0 - 0.15 / np.maximum(np.abs(d), 1e-12)))
    assert gauge.first_rate(d) <= slowest + 1e-12
    assert slowest <= gauge.farthest_first_rate + 1e-12


def test_rates_by_hand():
    assert GAUGE.ideal_rate == pytest.approx(0.92)  # 1 - 0.24 / 3: joint 1 from its lower limit
    assert replace(GAUGE, max_step=np.full(7, 0.3)).ideal_rate == pytest.approx(0.9)
    assert ideal_step(GAUGE, deviation(j1=-3.0, j2=0.5)) == pytest.approx(deviation(j1=0.24, j2=-0.05))
    far = deviation(j1=-3.0)
    assert GAUGE.value(far + ideal_step(GAUGE, far)) == pytest.approx(0.92)


def test_the_box_of_the_world(world, station):
    gauge = BoxGauge.of(world)
    lower, upper, _ = (v[:7] for v in controller_limits(station))
    home = world.initial_posture[:7]
    assert home + gauge.up == pytest.approx(upper - np.deg2rad(2.0))
    assert home - gauge.down == pytest.approx(lower + np.deg2rad(2.0))
    assert gauge.gain == pytest.approx(0.1)
    assert np.rad2deg(gauge.up[3]) == pytest.approx(20.0)  # 105 - 83 - 2 deg
    assert gauge.ideal_rate == pytest.approx(1 - 12 / 186)
    assert gauge.level_within(np.deg2rad(3.0)) == pytest.approx(2 / 185)
    assert gauge.first_step == pytest.approx(np.full(7, 14.0 * 0.1**2))  # 8 deg, less than the speed allows
    assert gauge.farthest_first_rate == pytest.approx(1 - np.rad2deg(0.14) / 186)
    free = BoxGauge.of(replace(world, regulator=replace(world.regulator, acceleration=1e6)))
    assert np.array_equal(free.first_step, free.max_step)


def test_other_loops_are_not_certified(world):
    assert scalar_gain(0.3 * np.eye(3)) == pytest.approx(0.3)
    for K in (np.diag([0.1, 0.2]), np.array([[0.1, 0.01], [0.01, 0.1]]), np.eye(2)):
        with pytest.raises(InputError, match=r"give world\.regulator numbers"):
            scalar_gain(K)
    with pytest.raises(InputError, match="within 5 deg of a joint limit"):
        BoxGauge.of(replace(world, initial_joints_deg=[28.0, 30.0, 0.0, 101.0, 0.0, 62.0, 0.0]))


@given(DEVIATIONS, st.floats(0.0, 10.0))
def test_the_gauge_is_positive_homogeneous(d, factor):
    assert GAUGE.value(factor * d) == pytest.approx(factor * GAUGE.value(d), abs=1e-12)


@given(DEVIATIONS, st.sampled_from([0.0, 0.05]))
def test_the_ideal_loop_contracts_and_leaves_no_sublevel_set(d, core):
    gauge = replace(GAUGE, core=core)
    now, then = gauge.value(d), gauge.value(d + ideal_step(gauge, d))
    assert now <= 1.0 + 1e-12
    assert then <= gauge.ideal_rate * now + 1e-12


def test_samples_are_in_the_box_and_on_its_border():
    rng = np.random.default_rng(0)
    samples = np.array([GAUGE.sample(rng) for _ in range(2000)])
    assert GAUGE.value(samples).max() <= 1.0
    # Uniform: below half the level lies the share 2^-7, and in each joint up / (up + down) above home.
    assert np.mean(GAUGE.value(samples) < 0.9) == pytest.approx(0.9**7, abs=0.04)
    assert np.mean(samples > 0, axis=0) == pytest.approx(GAUGE.up / (GAUGE.up + GAUGE.down), abs=0.04)
    assert all(GAUGE.value(GAUGE.to_border(d)) == pytest.approx(1.0) for d in samples[:10])
