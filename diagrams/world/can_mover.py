"""The can is put elsewhere on the desk, once, in the middle of a tick: out of the hand, or while the hand comes."""

import math
from collections.abc import Callable, Iterable

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import BasicVector, Context, EventStatus, InputPort, LeafSystem, State

from diagrams.world.configuration import Timing
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import CAN_HALF_HEIGHT


def declare_can_place(plant: MultibodyPlant, can: RigidBody, timing: Timing) -> InputPort:
    """Declares an input of the finalized `plant` and an event that, in the middle of each tick, puts `can` there.

    The input, returned, is `can_place` (2,), x and y on the desk, m, world: the can stands there upright, see
    `declare_pose`.
    """
    return declare_pose(plant, can, timing, "can_place", 2, lambda place: (1.0, 0.0, 0.0, 0.0, *place, CAN_HALF_HEIGHT))


def declare_pose(
    plant: MultibodyPlant,
    can: RigidBody,
    timing: Timing,
    name: str,
    size: int = 7,
    pose: Callable[[np.ndarray], Iterable[float]] = tuple,
) -> InputPort:
    """Declares the input `name` (size,) and an event that, in the middle of each tick, puts `can` as it says.

    An event writes no state but its own system's: so it is one of the plant. `pose` makes quaternion wxyz and position
    (m, world) of the input: there the can is from the middle of the tick on, at rest. Where the input is NaN, or not
    connected, the can stays where it is.
    """
    port = plant.DeclareVectorInputPort(name, size)
    q = can.floating_positions_start()
    v = plant.num_positions() + can.floating_velocities_start_in_v()

    def put(context: Context, state: State) -> EventStatus:
        if not port.HasValue(context) or np.isnan(given := port.Eval(context)).any():
            return EventStatus.DidNothing()
        x = state.get_mutable_discrete_state().get_mutable_value()
        x[q : q + 7] = tuple(pose(given))
        x[v : v + 6] = 0.0
        return EventStatus.Succeeded()

    # Between the plant's last two steps before the middle, so that rounding decides nothing.
    steps = max(round(timing.period / timing.time_step) // 2, 1) - 0.5
    plant.DeclarePeriodicUnrestrictedUpdateEvent(timing.period, steps * timing.time_step, put)
    return port


class CanMover(LeafSystem):
    """Says in which tick the can is put elsewhere on the desk: see DisturbanceSpec.

    .. pydrake_system::

        name: CanMover
        input_ports:
        - ticks_since_onset
        output_ports:
        - can_place
        - taken

    - `ticks_since_onset` (1): see Disturbance.
    - `can_place` (2), m, world: in that tick where the can is put, see `declare_can_place`; else NaN.
    - `taken` (1): 1 from that tick on, else 0.

    Place and tick are parameters of the Context (`set_parameters`). No state.
    """

    def __init__(self):
        super().__init__()
        self._place = self.DeclareNumericParameter(BasicVector([math.nan] * 2))
        self._tick = self.DeclareNumericParameter(BasicVector([0.0]))
        self._ticks = self.DeclareVectorInputPort("ticks_since_onset", 1)
        self.DeclareVectorOutputPort("can_place", 2, self._calc_place)
        self.DeclareVectorOutputPort("taken", 1, self._calc_taken)

    def set_parameters(self, context: Context, given: DisturbanceSpec) -> None:
        """Sets, in this system's Context, what happens to the can under `given`."""
        place = given.can_moved_to
        context.get_mutable_numeric_parameter(self._place).SetFromVector([math.nan] * 2 if place is None else place)
        context.get_mutable_numeric_parameter(self._tick).SetFromVector([float(given.can_tick)])

    def _since(self, context: Context) -> float:
        """Ticks since the can was put elsewhere; negative before."""
        return self._ticks.Eval(context)[0] - context.get_numeric_parameter(self._tick)[0]

    def _calc_place(self, context: Context, output: BasicVector) -> None:
        now = self._since(context) == 0.0
        output.SetFromVector(context.get_numeric_parameter(self._place).value() if now else [math.nan] * 2)

    def _calc_taken(self, context: Context, output: BasicVector) -> None:
        given = not np.isnan(context.get_numeric_parameter(self._place).value()).any()
        output[0] = float(given and self._since(context) >= 0.0)
