"""The task: its goals, their tolerances, and what went wrong first where it failed. No other file defines its success.

Success: the can stands on the vacant spot, upright, the fingers really open; the other can has not moved; the arm is at
rest at its initial posture, for half a second; within 60 s plus the time disturbed. Time disturbed is from the onset to
the tick at which the network has the arm again (alpha <= 0.1 at the initial posture); without that, the disturbance
alone.
"""

from dataclasses import dataclass

import numpy as np

from diagrams.world.names import CAN_HALF_HEIGHT

HOME_TOLERANCE = np.deg2rad(3.0)  # a joint
REST_SPEED = np.deg2rad(2.0)  # a joint, per s
REST_SECONDS = 0.5
PLACE_TOLERANCE = 0.030  # m
NEIGHBOUR_TOLERANCE = 0.020  # m
UPRIGHT_TOLERANCE = np.deg2rad(15.0)
OPEN_TOLERANCE = 0.005  # m: how far the measured gap of fingers that are open may be below the open one
LIFTED = 0.04  # m above where it stood: the can is picked
TIME_LIMIT = 60.0  # s, plus the time disturbed
STALLED_TICKS, STALLED = 50, np.deg2rad(0.1)  # no joint moved by more in a tick of the last so many: the arm stalled

TASK_FAILURES = ("can toppled", "missed grasp", "misplaced", "neighbour moved", "stalled", "time")


def tilt(can_pose: np.ndarray) -> np.ndarray:
    """Angle of a can's axis to the vertical, rad (...), of its pose (..., 7): quaternion wxyz, position."""
    across = (can_pose[..., 1:3] ** 2).sum(axis=-1) / (can_pose[..., :4] ** 2).sum(axis=-1)
    return np.arccos(np.clip(1.0 - 2.0 * across, -1.0, 1.0))


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


def lasting_from(wrong: np.ndarray) -> int | None:
    """Index from which on `wrong` (n,) holds to the end; None where it does not at the end."""
    right = np.flatnonzero(~wrong)
    first = int(right[-1]) + 1 if len(right) else 0
    return first if first < len(wrong) else None


@dataclass(frozen=True)
class TaskMonitor:
    """The goals in one scene. `can_poses`: (..., 14) as PickPlaceStation gives them; `posture`: (..., 8), rad and m.

    `place`, `neighbour`: (3,) where the can shall stand, and where the other one stood, m, world.
    """

    place: np.ndarray
    neighbour: np.ndarray
    initial_posture: np.ndarray  # (8,)
    period: float = 0.1  # between two rows, s

    def placed(self, can_poses: np.ndarray) -> np.ndarray:
        """The can stands on its spot, upright: (...) bool."""
        return _stands(can_poses[..., :7], self.place, PLACE_TOLERANCE)

    def neighbour_untouched(self, can_poses: np.ndarray) -> np.ndarray:
        """The other can has not moved and is upright: (...) bool."""
        return _stands(can_poses[..., 7:], self.neighbour, NEIGHBOUR_TOLERANCE)

    def home(self, posture: np.ndarray) -> np.ndarray:
        """The arm is at its initial posture: (...) bool."""
        return at_home(posture[..., :-1], self.initial_posture[:-1])

    def at_rest(self, postures: np.ndarray) -> bool:
        """The arm is at its initial posture and slow, for the last half second of a run's `postures` (n, 8)."""
        last = postures[-round(REST_SECONDS / self.period) - 1 :]
        if (len(last) - 0.5) * self.period < REST_SECONDS:
            return False
        speeds = np.abs(np.diff(last[:, :-1], axis=0)) / self.period
        return bool(self.home(last).all() and (speeds < REST_SPEED).all())

    def released(self, posture: np.ndarray) -> np.ndarray:
        """The fingers are commanded open: (...) bool."""
        return released(posture, self.initial_posture[-1])

    def held(self, can_poses: np.ndarray, posture: np.ndarray) -> np.ndarray:
        """The can is in the hand: (...) bool."""
        return held(can_poses, posture, self.initial_posture[-1])

    def success(self, can_poses: np.ndarray, postures: np.ndarray, gap: float) -> bool:
        """The whole task is done.

        Args:
            can_poses: (14,) now.
            postures: (n, 8) of the run so far, a row a tick; the last half second of them is read.
            gap: of the fingers now, as measured, m.
        """
        done = self.placed(can_poses) and self.neighbour_untouched(can_poses)
        opened = self.released(postures[-1]) and gap > self.initial_posture[-1] - OPEN_TOLERANCE
        return bool(done and opened and self.at_rest(postures))

    def failure(self, can_poses: np.ndarray, posture: np.ndarray) -> tuple[str, int]:
        """The kind of a failed task, by the rows of a whole run, (n, 14) and (n, 8); and at which row it failed.

        Of all that is wrong at the end, what has been wrong for longest: that went wrong first.
        """
        n, held, closed = len(posture), self.held(can_poses, posture), ~self.released(posture)
        still = np.append(False, np.abs(np.diff(posture[:, :-1], axis=0)).max(axis=1) < STALLED)
        closings, openings = (np.flatnonzero(np.diff(turn.astype(int)) > 0) + 1 for turn in (closed, ~closed))
        found = {
            "neighbour moved": lasting_from(~self.neighbour_untouched(can_poses)),
            "can toppled": lasting_from((tilt(can_poses[:, :7]) > UPRIGHT_TOLERANCE) & ~held),
            # The last grasp, or the last release of the can from the hand, after which the hand never had it.
            "missed grasp": closings[-1] if len(closings) and not held[closings[-1] :].any() else None,
            "misplaced": next(
                (k for k in openings[::-1] if held[k - 1] and not held[k:].any() and not self.placed(can_poses[-1])),
                None,
            ),
            "stalled": first if (first := lasting_from(still)) is not None and n - first >= STALLED_TICKS else None,
        }
        kinds = [(k, kind) for kind, k in found.items() if k is not None]
        when, kind = min(kinds, key=lambda entry: entry[0], default=(n - 1, "time"))
        return kind, int(when)


def _stands(can_pose: np.ndarray, place: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether a can (..., 7) is within `tolerance` (m) of `place` (3,), upright: (...) bool."""
    near = np.linalg.norm(can_pose[..., 4:] - place, axis=-1) < tolerance
    return near & (tilt(can_pose) < UPRIGHT_TOLERANCE)
