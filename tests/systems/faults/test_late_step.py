"""LateStep: what the arm follows where steps are late, and which are."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.disturbance import DisturbanceParameters
from systems.faults.fault import Setting
from systems.faults.late_step import LateStep

TICKS, PERIOD = 400, 0.1


def run(share, seed=0, ticks=TICKS, told=True):
    """The command of tick k is k + 1, before the first it is 0; what is followed in each tick.

    `share`: as a signal, or, not `told`, the severity of a fault from tick 0 on.
    """
    system = LateStep(Setting(1, 1, PERIOD, 112, 112, {}), told)
    simulator = Simulator(system)
    context, found = simulator.get_mutable_context(), []
    system.set_parameters(context, DisturbanceParameters(severity=0.0 if told else share), seed)
    for port, value in (("desired_posture", 0.0), *([("share", share)] if told else [("ticks_since_onset", -1.0)])):
        system.GetInputPort(port).FixValue(context, [value])
    for k in range(ticks):
        # As the controller's own update does, at the same time: this one sees the command of the tick before.
        simulator.AdvanceTo(k * PERIOD)
        simulator.AdvanceTo(k * PERIOD + 0.01)
        system.GetInputPort("desired_posture").FixValue(context, [k + 1.0])
        if not told:
            system.GetInputPort("ticks_since_onset").FixValue(context, [float(k)])
        found.append(float(system.GetOutputPort("faulty_desired_posture").Eval(context)[0]))
    return np.array(found)


def test_without_a_share_it_is_the_command():
    assert run(0.0, ticks=30).tolist() == list(range(1, 31))


def test_at_the_full_share_the_first_command_holds():
    assert run(1.0, ticks=30).tolist() == [0.0] * 30


def test_a_late_tick_has_the_command_of_the_tick_before():
    found = run(0.3)
    late = found != np.arange(1, TICKS + 1)
    before = np.append(0.0, found[:-1])
    assert np.array_equal(found[late], before[late])
    assert 0.2 < late.mean() < 0.4
    assert late[1:][late[:-1]].any()  # two in a row hold the same one


@pytest.mark.parametrize("seed", [0, 7, 2**40])
def test_the_seed_draws_and_a_larger_share_is_more(seed):
    mild, grave = (run(severity, seed) != np.arange(1, TICKS + 1) for severity in (0.1, 0.5))
    assert np.array_equal(mild, run(0.1, seed) != np.arange(1, TICKS + 1))
    assert mild.sum() < grave.sum()
    assert not (mild & ~grave).any()
    assert not np.array_equal(mild, run(0.1, seed + 1) != np.arange(1, TICKS + 1))


@pytest.mark.parametrize("severity", [0.0, 0.4, 1.0])
def test_as_a_fault_it_is_late_in_half_of_the_ticks_at_most(severity):
    """The same ticks as with that share as a signal, but for the first, which is the onset's."""
    assert np.array_equal(run(severity, told=False)[1:], run(0.5 * severity)[1:])
    assert (run(severity, told=False) != np.arange(1, TICKS + 1)).mean() == pytest.approx(0.5 * severity, abs=0.06)
