"""Disturbance: what the arm is told at each tick around the onset."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.disturbance import MOVE_TICKS, Disturbance, DisturbanceParameters
from tests.systems.system_checks import run_from

PERIOD = 0.1


def prepared(**parameters):
    """The system, and a Context with a disturbance of these parameters."""
    system = Disturbance(posture_size=2)
    context = system.CreateDefaultContext()
    system.set_parameters(context, DisturbanceParameters(**parameters))
    return system, context


def run(system, context, ticks, trigger):
    """Runs `ticks` ticks with the command [k, 10 k] of tick k; returns the outputs after each tick's update.

    As in the loop with the controller, the update of tick k still sees the command of tick k - 1.
    """
    simulator = Simulator(system, context)
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
    assert run(*prepared(level=1.0), 4, below_from(0)) == [through(k) for k in range(4)]
    system = Disturbance(posture_size=2)
    assert run(system, system.CreateDefaultContext(), 4, below_from(0)) == [through(k) for k in range(4)]


def test_b_holds_the_command_of_the_onset():
    expected = [through(0), through(1)] + [[1.0, 10.0, 1.0]] * 3 + [through(5), through(6), through(7)]
    assert run(*prepared(kind="B", level=0.1, hold_ticks=3), 8, below_from(2)) == expected


def test_a_moves_then_holds_and_what_has_no_target_keeps_its_command():
    assert MOVE_TICKS == 8
    moved = [[joint, 10.0, 1.0] for joint in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.0, 5.0)]
    found = run(*prepared(kind="A", target=[5.0], level=0.1, hold_ticks=2), 14, below_from(2))
    assert found == [through(0), through(1), *moved, through(12), through(13)]


def test_happens_once():
    found = run(*prepared(kind="B", level=0.1, hold_ticks=1), 8, lambda k: 0.05 if k % 3 == 1 else 0.2)
    assert [active for *_, active in found] == [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_level_itself_does_not_trigger():
    assert run(*prepared(kind="B", level=0.2, hold_ticks=1), 3, lambda k: 0.2) == [through(k) for k in range(3)]


def test_ticks_since_the_onset():
    system, context = prepared(kind="B", level=0.1, hold_ticks=1)
    assert system.GetOutputPort("ticks_since_onset").Eval(context)[0] == -1
    run(system, context, 4, below_from(2))
    assert system.GetOutputPort("ticks_since_onset").Eval(context)[0] == 1


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        ({"kind": "D", "level": 1.0}, "kind is 'D'"),
        ({"kind": "B", "hold_ticks": 1}, "level is None"),
        ({"kind": "B", "level": float("nan"), "hold_ticks": 1}, "level is nan"),
        ({"kind": "B", "level": 1.0}, "hold_ticks is 0"),
        ({"kind": "A", "level": 1.0}, "target is None"),
        ({"kind": "A", "level": 1.0, "target": [float("nan")]}, "target is"),
    ],
)
def test_what_makes_no_disturbance_is_refused(parameters, named):
    with pytest.raises(ValueError, match=named):
        prepared(**parameters)


def test_clone_in_the_middle_of_a_disturbance_replays():
    system, context = prepared(kind="A", target=[5.0], level=0.1)
    rng = np.random.default_rng(0)
    inputs = [dict(desired_posture=rng.normal(size=2), trigger=[below_from(3)(k)]) for k in range(12)]
    run_from(system, context, inputs[:6], PERIOD)
    clone = context.Clone()
    first = run_from(system, context, inputs[6:], PERIOD)
    assert first == run_from(system, clone, inputs[6:], PERIOD)
    assert first[0] != first[1]  # it moves
