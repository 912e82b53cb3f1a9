"""The faults of sensors, servo and people: numbers worked out by hand."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagrams.world.faults.registry import FAULTS
from tests.systems.faults.fault_cases import ELBOW, HAND, PERIOD, SETTING, J, context_of, evaluate

POSTURE = np.array([0.1, -0.2, 0.3, 0.08])


def read(name, severity, **when):
    return evaluate(name, "faulty_posture", {"posture": POSTURE}, severity, **when)


def test_offset_is_of_one_joint_and_of_its_size():
    joints, sides = set(), set()
    for seed in range(24):
        off = read("joint_offset", 0.5, seed=seed) - POSTURE
        (joint,) = np.flatnonzero(off)
        assert np.rad2deg(abs(off[joint])) == pytest.approx(2.5)
        joints.add(int(joint))
        sides.add(float(np.sign(off[joint])))
    assert (joints, sides) == ({0, 1, 2}, {-1.0, 1.0})


def test_noise_is_on_the_joints_alone():
    off = np.array([read("joint_noise", 0.5, ticks=k) - POSTURE for k in range(400)])
    assert np.rad2deg(off[:, :J].std(axis=0)) == pytest.approx(0.5, rel=0.15)
    assert not off[:, J:].any()


def test_a_stuck_joint_reads_as_at_the_onset():
    system = FAULTS["joint_stuck"](SETTING)
    simulator, found = Simulator(system, context_of(system, 0.5, hold=4)), []
    context = simulator.get_mutable_context()
    for k in range(6):
        system.GetInputPort("posture").FixValue(context, np.full(J + 1, float(k)))
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(max(k - 1 - 1, -1))])
        found.append(sorted(system.GetOutputPort("faulty_posture").Eval(context).tolist()))
        simulator.AdvanceTo((k + 0.5) * PERIOD)
    # The onset is at tick 1; half of four ticks.
    assert found == [[0.0] * 4, [1.0] * 4, [1.0, 2.0, 2.0, 2.0], [1.0, 3.0, 3.0, 3.0], [4.0] * 4, [5.0] * 4]


def servo(name, severity, **when):
    """How much is left of what pulls each component."""
    command, inputs = POSTURE + 0.1, {"joint_angles": POSTURE[:J], "finger_gap": POSTURE[J:]}
    found = evaluate(name, "faulty_desired_posture", inputs | {"desired_posture": command}, severity, **when)
    return (found - POSTURE) / 0.1


def test_a_weak_servo_is_of_one_joint():
    left = np.array([servo("weak_servo", 0.5, seed=seed) for seed in range(24)])
    assert np.allclose(np.sort(left, axis=1), [0.525, 1.0, 1.0, 1.0])
    assert set(np.argmin(left, axis=1)) == {0, 1, 2}


def test_a_slack_gripper_pulls_with_nothing():
    assert servo("slack_gripper", 1.0) == pytest.approx([1.0, 1.0, 1.0, 0.0])
    assert servo("slack_gripper", 0.5) == pytest.approx([1.0, 1.0, 1.0, 0.25])


@pytest.mark.parametrize(("name", "body", "newtons"), [("push_hand", HAND, 20.0), ("push_elbow", ELBOW, 40.0)])
def test_a_push_is_level_and_the_servo_soft(name, body, newtons):
    inputs = {"desired_posture": POSTURE, "joint_angles": POSTURE[:J], "finger_gap": POSTURE[J:]}
    angles = []
    for seed in range(8):
        (force,) = evaluate(name, "spatial_force", inputs, 0.5, seed=seed)
        x, y, z = force.F_Bq_W.translational()
        assert np.hypot(x, y) == pytest.approx(newtons)
        assert (z, force.body_index, force.p_BoBq_B.tolist()) == (0.0, body[0], body[1].tolist())
        angles.append(np.arctan2(y, x))
    assert np.ptp(angles) > 1.0
    assert servo(name, 0.5) == pytest.approx([0.525, 0.525, 0.525, 1.0])
    assert evaluate(name, "spatial_force", inputs, 1.0, ticks=20, hold=10) == []


def test_a_payload_is_its_weight():
    (force,) = evaluate("payload", "spatial_force", {}, 0.5)
    assert force.F_Bq_W.translational().tolist() == pytest.approx([0.0, 0.0, -9.81])
    assert (force.body_index, force.p_BoBq_B.tolist()) == (HAND[0], HAND[1].tolist())


def moved(name, alpha, severity=1.0, ticks=200):
    """Of a command that is 0, what comes out in each tick; `alpha`: by the tick. The onset is at tick 0."""
    system = FAULTS[name](SETTING)
    simulator, found = Simulator(system, context_of(system, severity, hold=2)), []
    context = simulator.get_mutable_context()
    for k in range(ticks):
        system.GetInputPort("desired_posture").FixValue(context, np.zeros(J + 1))
        system.GetInputPort("alpha").FixValue(context, [alpha(k)])
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(k - 1)])
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        found.append(system.GetOutputPort("faulty_desired_posture").Eval(context).copy())
    return np.array(found)


def stretches(rows):
    """First and last tick, and the last posture, of each stretch that is not 0."""
    on = np.flatnonzero(np.diff(np.r_[0, rows.any(axis=1), 0].astype(int)))
    return [(int(a), int(b) - 1, rows[b - 1].round(6).tolist()) for a, b in on.reshape(-1, 2)]


FIRST, SECOND, THIRD = ([*(0.3 * np.arange(n, n + J)).round(6).tolist(), 0.0] for n in (1, 4, 7))


def test_moved_as_under_A():
    rows = moved("disturbed_thrice", lambda k: 0.0, severity=0.5)
    assert rows[1, 0] == pytest.approx(0.5 * 0.3 / 8)  # an eighth of the way a tick, to half of the target
    assert rows[8, 0] == rows[10, 0] == pytest.approx(0.15)
    assert not rows[11].any()


def test_three_times_with_a_pause():
    # Eight ticks of moving, two of holding, 60 between.
    found = stretches(moved("disturbed_thrice", lambda k: 0.0))
    assert found == [(1, 10, FIRST), (71, 80, SECOND), (141, 150, THIRD)]


def test_again_on_the_way_home():
    assert stretches(moved("disturbed_return", lambda k: 1.0)) == [(1, 10, FIRST), (19, 28, SECOND)]
    assert stretches(moved("disturbed_return", lambda k: 0.0)) == [(1, 10, FIRST)]  # nobody brings it home


def test_again_at_the_resumption():
    found = stretches(moved("disturbed_resumption", lambda k: float(5 <= k < 40)))
    assert found == [(1, 10, FIRST), (40, 49, SECOND)]
    assert stretches(moved("disturbed_resumption", lambda k: 0.0)) == [(1, 10, FIRST)]
