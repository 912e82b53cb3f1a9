"""Inverse kinematics of the hand, by Drake's InverseKinematics on the arm alone."""

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.solvers import Solve

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import arm_plant
from models.errors import InputError

TILT_DEG = 85.0  # down, leaning outwards by 5: leaves 9 deg to every joint limit over the whole grid


class HandKinematics:
    """Joint angles that put the grasp frame somewhere, nearest to a preferred posture."""

    def __init__(self, world: World):
        """The arm of `world`; it prefers the initial posture."""
        self._plant = arm_plant(world)
        self._context = self._plant.CreateDefaultContext()
        self._preferred = np.append(world.initial_posture[:ARM_JOINTS], [0.0, 0.0])
        self.lower = self._plant.GetPositionLowerLimits()[:ARM_JOINTS]
        self.upper = self._plant.GetPositionUpperLimits()[:ARM_JOINTS]

    def solve_ik(self, position: np.ndarray) -> np.ndarray:
        """(7,) joint angles, rad: grasp frame at `position` (3, m, world), fingers level, across the arm's direction.

        Raises InputError where no posture within the joint limits reaches.
        """
        yaw, tilt = np.arctan2(position[1], position[0]), np.deg2rad(TILT_DEG)
        z = np.array([np.cos(tilt) * np.cos(yaw), np.cos(tilt) * np.sin(yaw), -np.sin(tilt)])
        x = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        R_WG = RotationMatrix(np.column_stack([x, np.cross(z, x), z]))
        ik, world, grasp = (
            InverseKinematics(self._plant),
            self._plant.world_frame(),
            self._plant.GetFrameByName("grasp"),
        )
        ik.AddPositionConstraint(grasp, np.zeros(3), world, position, position)
        ik.AddOrientationConstraint(world, R_WG, grasp, RotationMatrix(), 1e-3)
        program = ik.prog()
        program.AddQuadraticErrorCost(np.eye(ARM_JOINTS + 2), self._preferred, ik.q())
        program.AddBoundingBoxConstraint(0.0, 0.0, ik.q()[ARM_JOINTS:])
        result = Solve(program, self._preferred)
        if not result.is_success():
            where = np.round(position, 3).tolist()
            raise InputError(f"the hand cannot reach {where} m: choose a place on the desk nearer to the trained area")
        return result.GetSolution(ik.q())[:ARM_JOINTS]

    def margin(self, joints: np.ndarray) -> float:
        """Smallest distance of `joints` (7, rad) to a joint limit, rad; negative outside."""
        return float(np.min(np.minimum(joints - self.lower, self.upper - joints)))

    def grasp_position(self, joints: np.ndarray) -> np.ndarray:
        """(3,) position of the grasp frame, m, world."""
        self._plant.SetPositions(self._context, np.append(joints, [0.0, 0.0]))
        return self._plant.GetFrameByName("grasp").CalcPoseInWorld(self._context).translation()
