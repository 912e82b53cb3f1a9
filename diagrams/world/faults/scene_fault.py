"""What the faults of the scene share: they are told where the cans stand."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.station import PickPlaceStation
from systems.faults.fault import Fault, Setting

NOWHERE = np.full(7, np.nan)


class SceneFault(Fault):
    """A fault of what stands around the arm.

    moved_by: least and largest distance (m) that a can is moved by at severity 1; None: none is moved.
    moves: which one, of CANS.
    """

    moved_by: ClassVar[tuple[float, float] | None] = None
    moves: ClassVar[int] = 0

    @abstractmethod
    def set_scene(self, root: Context, station: PickPlaceStation, given: DisturbanceSpec, stands: np.ndarray) -> None:
        """In the root's Context, after `set_parameters`; `stands`: (3,) the centre of its can, m, world."""


class PoseFault(SceneFault):
    """Puts a can elsewhere, once, in the middle of the tick of the onset.

    Output `can_pose` or, of the other can, `neighbour_pose`: (7,) quaternion wxyz and position, m, world, in that tick;
    else NaN. The pose is a parameter of the Context.
    """

    acts_on = "the can"
    needs = ("can_pose",)

    def __init__(self, setting: Setting):
        super().__init__(setting)
        self._pose = self.DeclareNumericParameter(BasicVector(NOWHERE))
        self.DeclareVectorOutputPort(self.needs[0], 7, self._calc_pose, {self._onset.ticket(), self.pn_ticket()})

    @abstractmethod
    def _placed(self, context: Context, given: DisturbanceSpec, stands: np.ndarray) -> np.ndarray:
        """The pose (7,) into which a can is put that stands at `stands` (3,), m, world."""

    def set_scene(self, root: Context, station: PickPlaceStation, given: DisturbanceSpec, stands: np.ndarray) -> None:
        """See SceneFault."""
        context = self.GetMyMutableContextFromRoot(root)
        context.get_mutable_numeric_parameter(self._pose).SetFromVector(self._placed(context, given, stands))

    def pose(self, root: Context) -> np.ndarray:
        """(7,): where the can is put."""
        return self.GetMyContextFromRoot(root).get_numeric_parameter(self._pose).value().copy()

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        now = self._ticks(context) == 0 and self.severity(context) > 0.0
        output.SetFromVector(context.get_numeric_parameter(self._pose).value() if now else NOWHERE)


class ShiftedCan(PoseFault):
    """Puts a can upright the share s, the severity, of the way to `can_moved_to`."""

    def _placed(self, context: Context, given: DisturbanceSpec, stands: np.ndarray) -> np.ndarray:
        assert given.can_moved_to is not None
        share = self.severity(context)
        place = (1.0 - share) * stands[:2] + share * np.array(given.can_moved_to)
        return np.array([1.0, 0.0, 0.0, 0.0, *place, stands[2]])
