"""How late the LQR may learn of the posture: the delay margin of mode `return`, in closed form and on the full plant.

The step of a tick is taken from the posture of d ticks before, and added to the posture measured now, as the command
is: d[k+1] = d[k] - gain d[k - delay] in each joint. The servo executes nine tenths of a step, and takes its own time.
"""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, DiscreteTimeDelay

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, SPOTS
from diagrams.world.station import PickPlaceStation
from systems.posture_history import PostureHistory
from systems.posture_regulator import make_posture_regulator

AMPLITUDE = np.deg2rad(5.0)  # of the joints, at the start: no step of theirs is clamped, and nothing is near
POSTURES = 3
PERIODS = 6  # of the slowest oscillation, simulated


def delay_margin(gain: float) -> int:
    """Largest delay, ticks, under which d[k+1] = d[k] - gain d[k - delay] is stable, for 0 < gain < 2.

    It is stable if and only if gain < 2 sin(pi / (2 (2 delay + 1))): there a pair of roots of z^(delay+1) - z^delay +
    gain leaves the unit circle (Levin and May 1976, A note on difference-delay equations).
    """
    delay = int(np.ceil(0.5 * (0.5 * np.pi / np.arcsin(0.5 * gain) - 1.0))) + 1
    while gain >= 2.0 * np.sin(0.5 * np.pi / (2 * delay + 1)):
        delay -= 1
    return delay


class DelayedLoop:
    """The station under the LQR, whose step comes `delay` >= 1 ticks late."""

    def __init__(self, world: World, delay: int):
        builder, period, initial = DiagramBuilder(), world.timing.period, world.initial_posture
        self._world, self._delay = world, delay
        self._station = builder.AddSystem(PickPlaceStation(world, camera=False))
        history = PostureHistory(posture_size=len(initial), horizon=0, period=period, initial_posture=initial)
        self._history = builder.AddNamedSystem("posture_history", history)
        self._late = builder.AddNamedSystem("late_posture", DiscreteTimeDelay(period, delay, len(initial)))
        regulator = make_posture_regulator(
            posture_size=len(initial), joints=ARM_JOINTS, initial_posture=initial, period=period,
            Q=world.regulator.state_weight, R=world.regulator.input_weight,
        )  # fmt: skip
        builder.AddNamedSystem("posture_regulator", regulator)
        command = builder.AddNamedSystem("command", Adder(2, len(initial)))
        builder.Connect(self._station.GetOutputPort("posture"), history.GetInputPort("posture"))
        builder.Connect(self._station.GetOutputPort("posture"), self._late.get_input_port())
        builder.Connect(self._late.get_output_port(), regulator.get_input_port())
        builder.Connect(history.GetOutputPort("posture"), command.get_input_port(0))
        builder.Connect(regulator.get_output_port(), command.get_input_port(1))
        builder.Connect(command.get_output_port(), self._station.GetInputPort("desired_posture"))
        self._diagram = builder.Build()

    def run(self, deviation: np.ndarray, ticks: int) -> np.ndarray:
        """(ticks + 1, 7) deviations from the initial posture, rad, from rest at `deviation` (7,), there ever before."""
        world, station = self._world, self._station
        context = self._diagram.CreateDefaultContext()
        station.set_scene(context, np.mean(world.grid.bounds, axis=0), SPOTS[0])
        start = world.initial_posture + np.append(deviation, 0.0)
        station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(context), station.arm, start[:ARM_JOINTS])
        self._history.GetMyMutableContextFromRoot(context).SetDiscreteState(0, start)
        late = self._late.GetMyMutableContextFromRoot(context)
        late.SetDiscreteState(np.tile(start, self._delay + 1))
        simulator, period = Simulator(self._diagram, context), world.timing.period
        simulator.Initialize()
        local, port, rows = station.GetMyContextFromRoot(context), station.GetOutputPort("posture"), [deviation]
        for k in range(1, ticks + 1):
            simulator.AdvanceTo(k * period)
            rows.append(port.Eval(local)[:ARM_JOINTS] - start[:ARM_JOINTS] + deviation)
        return np.array(rows)


def swings_die_out(rows: np.ndarray) -> bool:
    """Whether the deviations `rows` (n, 7) are smaller in their last quarter than in the second, in every joint."""
    n = len(rows) // 4
    second, last = (np.abs(part).max(axis=0) for part in (rows[n : 2 * n], rows[-n:]))
    return bool(np.all(last < second))


def measured_delay_margin(world: World, expected: int, seed: int = 0) -> int:
    """Largest delay, ticks, under which the arm comes to rest from each of POSTURES postures near home, on the plant.

    It is looked for from `expected` on, upwards or downwards; 0 stands for none.
    """
    from tqdm import tqdm

    starts = AMPLITUDE * np.random.default_rng(seed).choice([-1.0, 1.0], (POSTURES, ARM_JOINTS))

    def stable(delay: int) -> bool:
        # At the margin a swing takes 2 (2 delay + 1) ticks.
        loop, ticks = DelayedLoop(world, delay), 2 * PERIODS * (2 * delay + 1)
        for start in starts:
            bar.update()
            if not swings_die_out(loop.run(start, ticks)):
                return False
        return True

    delay = max(expected, 1)
    with tqdm(desc="delay margin", unit="run", disable=None) as bar:
        if stable(delay):
            while stable(delay + 1):
                delay += 1
            return delay
        while delay > 1 and not stable(delay - 1):
            delay -= 1
        return delay - 1
