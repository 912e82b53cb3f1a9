"""ApproachMeter: where the cans are, and how near the hand or the held can is to its goal."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from diagrams.world.names import CANS


class ApproachMeter(LeafSystem):
    """Reads the truth that scoring and disturbances need from the plant's body poses.

    .. pydrake_system::

        name: ApproachMeter
        input_ports:
        - body_poses
        output_ports:
        - can_poses
        - approach_distance

    - `body_poses`: the plant's port of that name.
    - `can_poses` (14): quaternion wxyz and position (m, world) of the can to pick, then of the can on the shelf.
    - `approach_distance` (1), m: for subtask 1 from the grasp frame to the centre of the can to pick, for subtask 2
      from that can to its place on the shelf. Which one is a parameter of the Context (`set_subtask`), as is the place
      (`set_place`; 3, m, world).
    """

    def __init__(self, plant: MultibodyPlant):
        super().__init__()
        self._cans = [int(plant.GetBodyByName("can", plant.GetModelInstanceByName(name)).index()) for name in CANS]
        grasp = plant.GetFrameByName("grasp")
        self._palm, self._X_PG = int(grasp.body().index()), grasp.GetFixedPoseInBodyFrame()
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._subtask = self.DeclareNumericParameter(BasicVector([1.0]))
        self._place = self.DeclareNumericParameter(BasicVector(np.zeros(3)))
        self.DeclareVectorOutputPort("can_poses", 14, self._calc_can_poses)
        self.DeclareVectorOutputPort("approach_distance", 1, self._calc_distance)

    def set_subtask(self, context: Context, subtask: int) -> None:
        """Chooses the distance that is measured: 1 or 2."""
        context.get_mutable_numeric_parameter(self._subtask).SetFromVector([float(subtask)])

    def set_place(self, context: Context, place: np.ndarray) -> None:
        """Where the can shall stand (3, m, world)."""
        context.get_mutable_numeric_parameter(self._place).SetFromVector(place)

    def _calc_can_poses(self, context, output) -> None:
        poses = self._poses.Eval(context)  # a new list at each call
        cans = [poses[body] for body in self._cans]
        parts = [part for X in cans for part in (X.rotation().ToQuaternion().wxyz(), X.translation())]
        output.SetFromVector(np.concatenate(parts))

    def _calc_distance(self, context, output) -> None:
        poses = self._poses.Eval(context)
        can = poses[self._cans[0]].translation()
        if context.get_numeric_parameter(self._subtask)[0] < 1.5:
            goal = poses[self._palm].multiply(self._X_PG.translation())
        else:
            goal = context.get_numeric_parameter(self._place).value()
        output.SetAtIndex(0, float(np.linalg.norm(goal - can)))
