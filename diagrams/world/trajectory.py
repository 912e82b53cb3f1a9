"""The teacher's motion: where the hand is when, for both subtasks, as one smooth joint trajectory."""

from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.trajectories import PiecewisePolynomial

from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import TILT_DEG, HandKinematics
from diagrams.world.names import ARM_JOINTS

# Of the waypoints of either subtask: home, down to the goal and up again, home.
TICKS = (
    (0, 20, 66, 75, 84, 86, 92, 99, 106, 134, 161),
    (0, 20, 94, 107, 120, 123, 129, 136, 143, 167, 192),
)
FINGERS_MOVE = 5  # index of the waypoint from which on they are closed (subtask 1) or open
SUBTASK_STEPS = tuple(ticks[-1] for ticks in TICKS)
GRASP_ABOVE_CENTRE = 0.010  # of the can, m
# Of the held can in the grasp frame, upright as the hand grasps it, which leans.
_R_GRASP_CAN = RotationMatrix.MakeXRotation(-np.deg2rad(90.0 + TILT_DEG))
X_GRASP_CAN = RigidTransform(_R_GRASP_CAN, _R_GRASP_CAN.multiply(np.array([0.0, 0.0, -GRASP_ABOVE_CENTRE])))
HOVER = 0.115  # height above the grasp from which the hand comes down on the can, m
FREE_DEVIATION, DWELL_DEVIATION = np.deg2rad(2.5), np.deg2rad(0.5)  # largest, a joint: see deviations()
DEVIATION_KNOTS = 10  # ticks
# Before it is let go the can floats this far above its spot: it must not be pressed into the shelf.
RELEASE_GAP = 0.004


class Waypoint(NamedTuple):
    """At `tick` of the subtask the hand is at `joints` (7, rad); from then on the fingers go to `opening` (m)."""

    tick: int
    joints: np.ndarray
    opening: float


def subtask_waypoints(world: World, hand: HandKinematics, centre: np.ndarray, subtask: int) -> list[Waypoint]:
    """Waypoints of subtask 1 (grasp the can) or 2 (put the held can down); `centre` of the can there, (3, m, world).

    Raises InputError for a place that the hand cannot reach.
    """
    home, grasp = world.initial_posture[:ARM_JOINTS], np.asarray(centre) + [0, 0, GRASP_ABOVE_CENTRE]
    low = 0.0 if subtask == 1 else RELEASE_GAP
    heights = (None, None, HOVER, 0.5 * HOVER, low, low, low, 0.5 * HOVER, HOVER, None, None)  # m; None: home
    coming, going = (world.opening, world.closed_opening) if subtask == 1 else (world.closed_opening, world.opening)
    joints = [home if height is None else hand.solve_ik(grasp + [0, 0, height]) for height in heights]
    openings = [coming] * FINGERS_MOVE + [going] * (len(joints) - FINGERS_MOVE)
    return list(map(Waypoint, TICKS[subtask - 1], joints, openings))


def commands(waypoints: list[Waypoint], steps: int) -> np.ndarray:
    """(steps, 8) the posture commanded at each tick for the next one: joint angles (rad) and opening (m)."""
    ticks, joints, openings = map(np.array, zip(*waypoints, strict=True))
    # Shape-preserving: no overshoot at the grasp, and no stop at the waypoints between.
    path = PiecewisePolynomial.CubicShapePreserving(ticks.astype(float), joints.T, zero_end_point_derivatives=True)
    k = np.arange(steps)
    opening = openings[np.searchsorted(ticks, k, side="right") - 1]
    return np.column_stack([path.vector_values(np.minimum(k + 1.0, ticks[-1])).T, opening])


def subtask_commands(world: World, hand: HandKinematics, centre: np.ndarray, subtask: int) -> np.ndarray:
    """(SUBTASK_STEPS[subtask - 1], 8) the commands of that subtask, see `commands` and `subtask_waypoints`."""
    return commands(subtask_waypoints(world, hand, centre, subtask), SUBTASK_STEPS[subtask - 1])


def deviations(waypoints: list[Waypoint], steps: int, rng: np.random.Generator) -> np.ndarray:
    """(steps, 8) what the arm is pushed off the commanded posture while it is taught, rad; fingers 0.

    DART (Laskey et al. 2017): the actions recorded stay those without it, so that pictures off the path come with the
    motion back to it. Smooth and bounded: free on the path, small at home, none where the fingers are near a can.
    """
    home = waypoints[0].joints
    away = [i for i, w in enumerate(waypoints) if not np.array_equal(w.joints, home)]
    # Over the goal, coming and going; and the waypoints at home before and after.
    leave, near, far, back = (waypoints[i].tick for i in (away[0] - 1, away[0], away[-1], away[-1] + 1))
    times = [leave, 0.5 * (leave + near), near, far, 0.5 * (far + back), back]
    sizes = [DWELL_DEVIATION, FREE_DEVIATION, 0.0]
    k = np.arange(1, steps + 1)
    amplitude = np.interp(k, times, sizes + sizes[::-1])
    ticks = np.arange(0.0, steps + DEVIATION_KNOTS, DEVIATION_KNOTS)
    knots = rng.uniform(-1.0, 1.0, (ARM_JOINTS, len(ticks)))
    path = PiecewisePolynomial.CubicShapePreserving(ticks, knots)
    rows = np.zeros((steps, ARM_JOINTS + 1))
    rows[:, :ARM_JOINTS] = amplitude[:, None] * path.vector_values(k.astype(float)).T
    return rows
