"""ManualDisturbance: what the arm is told while a person holds it, moves it, and lets it go, as often as he likes."""

from pydrake.systems.analysis import Simulator

from systems.disturbance import MOVE_TICKS
from systems.manual_disturbance import FREE, HOLD, MOVE, ManualDisturbance

PERIOD = 0.1


def run(grips):
    """The command is [k, 10 k] at tick k; `grips`: kind and target of each; the outputs after each tick's update."""
    system = ManualDisturbance(posture_size=2, joints=1, period=PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    command, found = system.GetInputPort("desired_posture"), []
    for k, grip in enumerate(grips):
        command.FixValue(context, [k - 1.0, 10.0 * (k - 1.0)])  # as in the loop, the update sees that of k - 1
        system.GetInputPort("grip").FixValue(context, grip)
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        command.FixValue(context, [float(k), 10.0 * k])
        posture, active = (system.GetOutputPort(n).Eval(context) for n in ("disturbed_posture", "active"))
        found.append([*posture.tolist(), active[0]])
    return found


def through(k):
    return [float(k), 10.0 * k, 0.0]


def test_held_twice():
    grips = [[FREE, 0]] * 2 + [[HOLD, 0]] * 3 + [[FREE, 0]] + [[HOLD, 0]] * 2 + [[FREE, 0]]
    held, again = [1.0, 10.0, 1.0], [5.0, 50.0, 1.0]
    assert run(grips) == [through(0), through(1), held, held, held, through(5), again, again, through(8)]


def test_moved_then_held_where_it_is():
    """From 1 to 5 in eight steps of 1/2; what has no target keeps its command; a hold in the middle keeps it there."""
    assert MOVE_TICKS == 8
    found = run([[FREE, 0]] * 2 + [[MOVE, 5]] * 4 + [[HOLD, 0]] * 2 + [[FREE, 0]])
    moved = [[joint, 10.0, 1.0] for joint in (1.5, 2.0, 2.5, 3.0)]
    assert found == [through(0), through(1), *moved, [3.0, 10.0, 1.0], [3.0, 10.0, 1.0], through(8)]


def test_moved_to_the_end_and_then_elsewhere():
    found = run([[FREE, 0]] * 2 + [[MOVE, 5]] * 10 + [[MOVE, 9]] * 2)
    assert [row[0] for row in found[2:]] == [1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.0, 5.0, 5.5, 6.0]
