"""The teacher's motion: where the hand is when, for both subtasks, as one smooth joint trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS

SUBTASK_STEPS = (161, 192)
GRASP_ABOVE_CENTRE = 0.010  # of the can, m
HOVER = 0.115  # height above the grasp from which the hand comes down on the can, m
FREE_DEVIATION, DWELL_DEVIATION = np.deg2rad(2.5), np.deg2rad(0.5)  # largest, a joint: see deviations()
DEVIATION_KNOTS = 10  # ticks
# Before it is let go the can floats this far above its spot: it must not be pressed into the shelf.
RELEASE_GAP = 0.004


@dataclass(frozen=True)
class Waypoint:
    """At `tick` the hand is at `joints` (7, rad); from then on the fingers are commanded to `opening` (m)."""

    tick: int
    joints: np.ndarray
    opening: float


def subtask_waypoints(world: World, hand: HandKinematics, centre: np.ndarray, subtask: int) -> list[Waypoint]:
    """Waypoints of subtask 1 (grasp the can at `centre`, 3, m, world) or 2 (put the held can there)."""
    home = world.initial_posture[:ARM_JOINTS]
    grasp = np.asarray(centre) + [0, 0, GRASP_ABOVE_CENTRE]
    open_, closed = world.opening, world.closed_opening

    def at(height: float) -> np.ndarray:
        return hand.solve_ik(grasp + [0, 0, height])

    if subtask == 1:
        return [
            Waypoint(0, home, open_),
            Waypoint(20, home, open_),
            Waypoint(66, at(HOVER), open_),
            Waypoint(75, at(0.5 * HOVER), open_),
            Waypoint(84, at(0.0), open_),
            Waypoint(86, at(0.0), closed),
            Waypoint(92, at(0.0), closed),
            Waypoint(99, at(0.5 * HOVER), closed),
            Waypoint(106, at(HOVER), closed),
            Waypoint(134, home, closed),
            Waypoint(161, home, closed),
        ]
    low = RELEASE_GAP
    return [
        Waypoint(0, home, closed),
        Waypoint(20, home, closed),
        Waypoint(94, at(HOVER), closed),
        Waypoint(107, at(0.5 * HOVER), closed),
        Waypoint(120, at(low), closed),
        Waypoint(123, at(low), open_),
        Waypoint(129, at(low), open_),
        Waypoint(136, at(0.5 * HOVER), open_),
        Waypoint(143, at(HOVER), open_),
        Waypoint(167, home, open_),
        Waypoint(192, home, open_),
    ]


def commands(waypoints: list[Waypoint], steps: int) -> np.ndarray:
    """(steps, 8) the posture commanded at each tick for the next one: joint angles (rad) and opening (m)."""
    ticks = np.array([w.tick for w in waypoints], dtype=float)
    # Shape-preserving: no overshoot at the grasp, and no stop at the waypoints between.
    path = PiecewisePolynomial.CubicShapePreserving(
        ticks, np.array([w.joints for w in waypoints]).T, zero_end_point_derivatives=True
    )
    rows = np.empty((steps, ARM_JOINTS + 1))
    for k in range(steps):
        rows[k, :ARM_JOINTS] = path.value(min(k + 1, ticks[-1]))[:, 0]
        rows[k, -1] = next(w.opening for w in reversed(waypoints) if w.tick <= k)
    return rows


def subtask_commands(world: World, hand: HandKinematics, centre: np.ndarray, subtask: int) -> np.ndarray:
    """(SUBTASK_STEPS[subtask - 1], 8) the commands of that subtask, see `commands` and `subtask_waypoints`."""
    return commands(subtask_waypoints(world, hand, centre, subtask), SUBTASK_STEPS[subtask - 1])


def deviations(waypoints: list[Waypoint], steps: int, rng: np.random.Generator) -> np.ndarray:
    """(steps, 8) rad: how far the arm is kept off the commanded posture (DART, Laskey et al. 2017); fingers 0.

    Smooth and bounded: free on the path, small while dwelling at home, none where the fingers are near a can. The
    actions recorded stay those without it, so that pictures off the path come with the motion back to it.
    """
    home = waypoints[0].joints
    hover = [w.tick for w in waypoints if not np.array_equal(w.joints, home)]
    near, far = hover[0], hover[-1]  # over the goal, coming and going
    leave = max(w.tick for w in waypoints if w.tick < near)
    back = min(w.tick for w in waypoints if w.tick > far)
    k = np.arange(1, steps + 1)
    middle_in, middle_out = 0.5 * (leave + near), 0.5 * (far + back)
    amplitude = np.interp(
        k,
        [leave, middle_in, near, far, middle_out, back],
        [DWELL_DEVIATION, FREE_DEVIATION, 0.0, 0.0, FREE_DEVIATION, DWELL_DEVIATION],
    )
    ticks = np.arange(0.0, steps + DEVIATION_KNOTS, DEVIATION_KNOTS)
    knots = rng.uniform(-1.0, 1.0, (ARM_JOINTS, len(ticks)))
    path = PiecewisePolynomial.CubicShapePreserving(ticks, knots)
    rows = np.zeros((steps, ARM_JOINTS + 1))
    rows[:, :ARM_JOINTS] = amplitude[:, None] * path.vector_values(k.astype(float)).T
    return rows
