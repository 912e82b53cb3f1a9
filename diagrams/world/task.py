"""The task: its goals, their tolerances, and what went wrong where it failed. No other file defines its success.

Success: the can stands on the vacant spot, upright, released; the other can has not moved; the arm is at its initial
posture; within 60 s plus the time disturbed. Time disturbed is from the onset to the tick at which the network has the
arm again (alpha <= 0.1 at the initial posture); without that, the disturbance alone.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from diagrams.world.names import CAN_HALF_HEIGHT

HOME_TOLERANCE = np.deg2rad(3.0)  # a joint
PLACE_TOLERANCE = 0.030  # m
NEIGHBOUR_TOLERANCE = 0.020  # m
UPRIGHT_TOLERANCE = np.deg2rad(15.0)
LIFTED = 0.04  # m above where it stood: the can is picked
TIME_LIMIT = 60.0  # s, plus the time disturbed
STALLED_TICKS, STALLED = 50, np.deg2rad(0.1)  # no joint moved by more in a tick of the last so many: the arm stalled

TASK_FAILURES = ("can toppled", "missed grasp", "misplaced", "neighbour moved", "stalled", "time")


def tilt(can_pose: np.ndarray) -> float:
    """Angle of a can's axis (pose: quaternion wxyz, position) to the vertical, rad."""
    R = RotationMatrix(Quaternion(can_pose[:4] / np.linalg.norm(can_pose[:4]))).matrix()
    return float(np.arccos(np.clip(R[2, 2], -1.0, 1.0)))


def at_home(joints: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Whether every joint of `joints` (..., 7) is near `home` (7,), rad: (...) bool."""
    return np.all(np.abs(joints - home) < HOME_TOLERANCE, axis=-1)


def lifted(can_poses: np.ndarray) -> np.ndarray:
    """Whether the can to pick is off the desk; `can_poses` (..., 14) as PickPlaceStation gives them: (...) bool."""
    return can_poses[..., 6] - CAN_HALF_HEIGHT > LIFTED


def released(posture: np.ndarray, opening: float) -> np.ndarray:
    """Whether the fingers are commanded open; `posture` (..., 8), `opening` (m) of the open fingers: (...) bool."""
    return posture[..., -1] > 0.5 * opening


def held(can_poses: np.ndarray, posture: np.ndarray, opening: float) -> np.ndarray:
    """Whether the can is in the hand: (...) bool."""
    return ~released(posture, opening) & lifted(can_poses)


@dataclass(frozen=True)
class TaskMonitor:
    """The goals in one scene. `can_poses`: (..., 14) as PickPlaceStation gives them; `posture`: (..., 8), rad and m.

    `place`, `neighbour`: (3,) where the can shall stand, and where the other one stood, m, world.
    """

    place: np.ndarray
    neighbour: np.ndarray
    initial_posture: np.ndarray  # (8,)

    def placed(self, can_poses: np.ndarray) -> bool:
        """The can stands on its spot, upright; `can_poses` (14,)."""
        near = math.dist(can_poses[4:7], self.place) < PLACE_TOLERANCE
        return bool(near and tilt(can_poses[:7]) < UPRIGHT_TOLERANCE)

    def neighbour_untouched(self, can_poses: np.ndarray) -> bool:
        """The other can has not moved and is upright; `can_poses` (14,)."""
        near = math.dist(can_poses[11:], self.neighbour) < NEIGHBOUR_TOLERANCE
        return bool(near and tilt(can_poses[7:]) < UPRIGHT_TOLERANCE)

    def home(self, posture: np.ndarray) -> np.ndarray:
        """The arm is at its initial posture: (...) bool."""
        return at_home(posture[..., :-1], self.initial_posture[:-1])

    def released(self, posture: np.ndarray) -> np.ndarray:
        """The fingers are commanded open: (...) bool."""
        return released(posture, self.initial_posture[-1])

    def held(self, can_poses: np.ndarray, posture: np.ndarray) -> np.ndarray:
        """The can is in the hand: (...) bool."""
        return held(can_poses, posture, self.initial_posture[-1])

    def success(self, can_poses: np.ndarray, posture: np.ndarray) -> bool:
        """The whole task is done; one tick's values."""
        done = self.released(posture) and self.placed(can_poses) and self.neighbour_untouched(can_poses)
        return bool(done and self.home(posture))

    def failure(self, can_poses: np.ndarray, posture: np.ndarray) -> str:
        """The kind of a failed task, by the rows of a whole run: (n, 14), (n, 8)."""
        end, last = can_poses[-1], posture[-1]
        moved = np.abs(np.diff(posture[-STALLED_TICKS:, :-1], axis=0)).max(initial=0.0)
        if not self.neighbour_untouched(end):
            return "neighbour moved"
        if tilt(end[:7]) > UPRIGHT_TOLERANCE and not self.held(end, last):
            return "can toppled"
        if moved < STALLED:
            return "stalled"
        if not lifted(can_poses).any():
            return "missed grasp"
        if self.released(last) and not self.placed(end):
            return "misplaced"
        return "time"
