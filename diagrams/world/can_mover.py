"""CanMover: takes the can out of the hand, once, in the middle of a tick, and puts it elsewhere on the desk."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from diagrams.world.disturbance import CAN_TAKEN_TICKS
from diagrams.world.station import PickPlaceStation
from systems.disturbance import Disturbance


class CanMover(LeafSystem):
    """Remembers where the can shall be put, and whether it has been; `act`, a Simulator monitor, does it.

    .. pydrake_system::

        name: CanMover

    No ports. Parameter of the Context: the place (2,), m, world; NaN where the can stays. Discrete state: (1,) 1 once
    the can was moved. A system cannot change another's state in an event, so a monitor does, and what it remembers is
    here.
    """

    def __init__(self, station: PickPlaceStation, disturbance: Disturbance, period: float):
        """`station`, `disturbance`: systems of the same root diagram; `period`: of the ticks, s."""
        super().__init__()
        self._station, self._disturbance, self._period = station, disturbance, period
        self._place = self.DeclareNumericParameter(BasicVector(np.full(2, np.nan)))
        self._moved = self.DeclareDiscreteState(1)

    def set_place(self, context: Context, place: list[float] | None) -> None:
        """Where the can is put (2, m, world), in this system's Context; None: it stays."""
        context.get_mutable_numeric_parameter(self._place).SetFromVector([math.nan] * 2 if place is None else place)

    def moved(self, root: Context) -> bool:
        """Whether the can was moved."""
        return bool(self.GetMyContextFromRoot(root).get_discrete_state(self._moved).value()[0])

    def act(self, root: Context) -> None:
        """Moves the can in the root Context from the middle of the CAN_TAKEN_TICKS-th tick of the disturbance on."""
        ticks = self._disturbance.ticks_since_onset(self._disturbance.GetMyContextFromRoot(root))
        if ticks != CAN_TAKEN_TICKS - 1:
            return
        place = self.GetMyContextFromRoot(root).get_numeric_parameter(self._place).value()
        time = root.get_time()
        tick = math.floor(time / self._period + 1e-6)
        if np.isnan(place).any() or self.moved(root) or time < (tick + 0.5) * self._period:
            return
        self._station.place_can(root, place)
        self.GetMyMutableContextFromRoot(root).SetDiscreteState(self._moved, [1.0])
