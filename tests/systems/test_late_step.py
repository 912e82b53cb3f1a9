"""LateStep: what the arm follows where steps are late, and which are."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.late_step import LateStep

TICKS = 400


def run(severity, seed=0, ticks=TICKS):
    """The command of tick k is k + 1, before the first it is 0; what is followed in each tick."""
    system = LateStep(posture_size=1, period=0.1)
    simulator = Simulator(system)
    context, found = simulator.get_mutable_context(), []
    system.set_seed(context, seed)
    system.GetInputPort("desired_posture").FixValue(context, [0.0])
    for k in range(ticks):
        system.GetInputPort("severity").FixValue(context, [severity])
        # As the controller's own update does, at the same time: this one sees the command of the tick before.
        simulator.AdvanceTo(k * 0.1)
        simulator.AdvanceTo(k * 0.1 + 0.01)
        system.GetInputPort("desired_posture").FixValue(context, [k + 1.0])
        found.append(float(system.get_output_port().Eval(context)[0]))
    return np.array(found)


def test_without_severity_it_is_the_command():
    assert run(0.0, ticks=30).tolist() == list(range(1, 31))


def test_at_full_severity_the_first_command_holds():
    assert run(1.0, ticks=30).tolist() == [0.0] * 30


def test_a_late_tick_has_the_command_of_the_tick_before():
    found = run(0.3)
    late = found != np.arange(1, TICKS + 1)
    before = np.append(0.0, found[:-1])
    assert np.array_equal(found[late], before[late])
    assert 0.2 < late.mean() < 0.4
    assert late[1:][late[:-1]].any()  # two in a row hold the same one


@pytest.mark.parametrize("seed", [0, 7, 2**40])
def test_the_seed_draws_and_more_severity_is_more(seed):
    mild, grave = (run(severity, seed) != np.arange(1, TICKS + 1) for severity in (0.1, 0.5))
    assert np.array_equal(mild, run(0.1, seed) != np.arange(1, TICKS + 1))
    assert mild.sum() < grave.sum()
    assert not (mild & ~grave).any()
    assert not np.array_equal(mild, run(0.1, seed + 1) != np.arange(1, TICKS + 1))
