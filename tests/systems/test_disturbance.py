"""Disturbance: what the arm is told at each tick around the onset."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.disturbance import Disturbance
from tests.systems.system_checks import assert_clone_replays

PERIOD = 0.1


def run(system, ticks, trigger, context=None):
    """Runs `ticks` ticks with the command [k, 10 k] of tick k; returns the outputs after each tick's update.

    As in the loop with the controller, the update of tick k still sees the command of tick k - 1.
    """
    simulator = Simulator(system, context or system.CreateDefaultContext())
    context = simulator.get_mutable_context()
    command = system.GetInputPort("desired_posture")
    found = []
    for k in range(ticks):
        command.FixValue(context, [k - 1.0, 10.0 * (k - 1.0)])
        system.GetInputPort("trigger").FixValue(context, [trigger(k)])
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        command.FixValue(context, [float(k), 10.0 * k])
        posture, active = (system.GetOutputPort(n).Eval(context) for n in ("disturbed_posture", "active"))
        found.append([*posture.tolist(), active[0]])
    return found


def through(k):
    return [float(k), 10.0 * k, 0.0]


def below_from(onset):
    return lambda k: 0.05 if k >= onset else 0.2


def test_none_is_transparent():
    system = Disturbance(posture_size=2, trigger_level=1.0)
    assert run(system, 4, below_from(0)) == [through(k) for k in range(4)]


def test_b_holds_the_command_of_the_onset():
    system = Disturbance(posture_size=2, kind="B", trigger_level=0.1, hold_ticks=3)
    expected = [through(0), through(1)] + [[1.0, 10.0, 1.0]] * 3 + [through(5), through(6), through(7)]
    assert run(system, 8, below_from(2)) == expected


def test_a_moves_then_holds_and_nan_keeps_the_command():
    system = Disturbance(
        posture_size=2, kind="A", target_posture=[5.0, np.nan], trigger_level=0.1, move_ticks=4, hold_ticks=2
    )
    moved = [[joint, 10.0, 1.0] for joint in (2.0, 3.0, 4.0, 5.0, 5.0, 5.0)]
    assert run(system, 10, below_from(2)) == [through(0), through(1), *moved, through(8), through(9)]


def test_happens_once():
    system = Disturbance(posture_size=2, kind="B", trigger_level=0.1, hold_ticks=1)
    found = run(system, 8, lambda k: 0.05 if k % 3 == 1 else 0.2)
    assert [active for *_, active in found] == [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_level_itself_does_not_trigger():
    system = Disturbance(posture_size=2, kind="B", trigger_level=0.2, hold_ticks=1)
    assert run(system, 3, lambda k: 0.2) == [through(k) for k in range(3)]


def test_parameters_are_set_per_context():
    system = Disturbance(posture_size=2)
    context = system.CreateDefaultContext()
    system.set_disturbance(context, "B", trigger_level=0.1, hold_ticks=2)
    assert [active for *_, active in run(system, 5, below_from(1), context)] == [0.0, 1.0, 1.0, 0.0, 0.0]
    context = system.CreateDefaultContext()
    system.set_disturbance(context, "A", [3.0, 4.0], trigger_level=0.1, hold_ticks=0)
    found = run(system, 10, below_from(0), context)
    assert found[7] == [3.0, 4.0, 1.0]
    assert found[8] == through(8)
    assert run(system, 3, below_from(0)) == [through(k) for k in range(3)]
    with pytest.raises(ValueError, match="kind is 'D'"):
        system.set_disturbance(context, "D")


def test_clone_in_the_middle_of_a_disturbance_replays():
    system = Disturbance(posture_size=2, kind="A", target_posture=[5.0, np.nan], trigger_level=0.1, move_ticks=4)
    rng = np.random.default_rng(0)
    inputs = [dict(desired_posture=rng.normal(size=2), trigger=[below_from(3)(k)]) for k in range(12)]
    assert_clone_replays(system, inputs, PERIOD)
