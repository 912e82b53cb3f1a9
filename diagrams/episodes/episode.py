"""Episode and outcome: the unit of everything that is counted, and the one definition of success (no other file defines any).

Task success: the can stands on the vacant spot, upright, released; the other can has not moved; the arm is at its initial posture; within
60 s plus the time disturbed. Time disturbed is from the onset to the tick at which the network has the arm again (alpha <= 0.1 at the initial
posture); without that, the disturbance alone.
Switching success, disturbed: alpha < 0.5 at every tick before the onset; alpha >= 0.9 before the end of the disturbance + 5 ticks; from then
on alpha >= 0.5 until the arm is at its initial posture; alpha <= 0.1 within 6 s after that. Undisturbed: alpha < 0.5 throughout.
Beside it, for the comparison with the paper, whose words ask for less: alpha >= 0.9 as above, and the arm at its initial posture at some later
tick, whoever led it there and whatever alpha was meanwhile, with alpha <= 0.1 within 6 s after that tick. Undisturbed: as above.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

HOME_TOLERANCE = np.deg2rad(3.0)  # a joint
PLACE_TOLERANCE = 0.030  # m
NEIGHBOUR_TOLERANCE = 0.020  # m
UPRIGHT_TOLERANCE = np.deg2rad(15.0)
LIFTED = 0.04  # m above where it stood: the can is picked
TIME_LIMIT = 60.0  # s, plus the time disturbed
FALSE_ALARM, DETECTED, RESUMED = 0.5, 0.9, 0.1  # values of alpha
DETECTION_TICKS = 5  # after the end of the disturbance
RESUME_SECONDS = 6.0  # after the arm is at its initial posture

# When a run ends before its time is up: with the task done; or as soon as the switching's success is decided, or the detection's.
Until = Literal["task", "switching", "detection"]

FAILURES = (
    "false switch", "not disturbed", "not detected", "not returned", "not resumed",
    "can toppled", "missed grasp", "misplaced", "neighbour moved", "stalled", "time", "simulation diverged",
)  # fmt: skip


@dataclass(frozen=True)
class DisturbanceDraw:
    """What the experimenter does, once, when `approach_distance` in `subtask` falls below `level` (m)."""

    kind: str = "none"  # none, A or B (Sec. IV-B)
    subtask: int = 1
    level: float = 0.0
    target_joints: tuple[float, ...] | None = None  # (7,) rad, kind A
    hold_ticks: int = 0
    can_moved_to: tuple[float, float] | None = None  # kind B in subtask 2: where the can is put meanwhile, m, world


@dataclass(frozen=True)
class Episode:
    """A scene, a disturbance and a controller."""

    seed: int
    can_xy: tuple[float, float]  # m, world
    vacant: str  # left or right
    disturbance: DisturbanceDraw = field(default_factory=DisturbanceDraw)
    rnn: str = "lstm"
    detector: str = "recall"


@dataclass
class Outcome:
    """What came of an episode; None where a field has no meaning (undisturbed, never reached)."""

    seed: int
    rnn: str
    detector: str
    disturbance: str
    can_xy: tuple[float, float]
    vacant: str
    picked: bool
    placed: bool
    home: bool
    success: bool | None  # None: not asked for, see Until
    switched: bool
    detection_delay_s: float | None
    false_switches: int
    returned: bool | None
    resumed: bool | None
    switch_success: bool
    paper_switch_success: bool | None  # in the paper's words; None: not asked for
    alpha_max_before: float
    return_s: float | None  # from the end of the disturbance to the initial posture
    resume_s: float | None  # from the initial posture to alpha <= 0.1
    failure: str | None  # one of FAILURES
    switch_failure: str | None
    sim_seconds: float
    wall_seconds: float = 0.0
    realtime_factor: float = 0.0
    weights_hash: str = ""

    def to_dict(self) -> dict:
        """Plain types, for JSON."""
        return dataclasses.asdict(self)


def tilt(can_pose: np.ndarray) -> float:
    """Angle of a can's axis (pose: quaternion wxyz, position) to the vertical, rad."""
    R = RotationMatrix(Quaternion(can_pose[:4] / np.linalg.norm(can_pose[:4]))).matrix()
    return float(np.arccos(np.clip(R[2, 2], -1.0, 1.0)))


@dataclass(frozen=True)
class TaskMonitor:
    """The task's goals in one scene; `place`, `neighbour`: (3,) where the can shall stand, where the other one stood, m, world."""

    place: np.ndarray
    neighbour: np.ndarray
    initial_posture: np.ndarray

    def placed(self, can_poses: np.ndarray) -> bool:
        """The can stands on its spot, upright; `can_poses` (14) as PickPlaceStation gives them."""
        return bool(
            np.linalg.norm(can_poses[4:7] - self.place) < PLACE_TOLERANCE and tilt(can_poses[:7]) < UPRIGHT_TOLERANCE
        )

    def neighbour_untouched(self, can_poses: np.ndarray) -> bool:
        """The other can has not moved and is upright."""
        return bool(
            np.linalg.norm(can_poses[11:] - self.neighbour) < NEIGHBOUR_TOLERANCE
            and tilt(can_poses[7:]) < UPRIGHT_TOLERANCE
        )

    def home(self, posture: np.ndarray) -> bool:
        """Every joint is near the initial posture; `posture` (8)."""
        return bool(np.all(np.abs(posture[:-1] - self.initial_posture[:-1]) < HOME_TOLERANCE))

    def released(self, posture: np.ndarray) -> bool:
        """The fingers are commanded open."""
        return bool(posture[-1] > 0.5 * self.initial_posture[-1])

    def success(self, can_poses: np.ndarray, posture: np.ndarray) -> bool:
        """The whole task is done."""
        return (
            self.released(posture)
            and self.placed(can_poses)
            and self.neighbour_untouched(can_poses)
            and self.home(posture)
        )


@dataclass(frozen=True)
class Switching:
    """The switching of one run, from its ticks; tick indices are None where the event did not come."""

    onset: int | None
    end: int | None  # first tick after the disturbance
    detected: int | None
    home: int | None
    resumed: int | None
    false_switches: int
    alpha_max_before: float
    failure: str | None
    as_in_paper: bool  # success in the paper's words
    decided: bool  # no later tick can change `failure`

    @classmethod
    def of(
        cls, alpha: np.ndarray, active: np.ndarray, at_home: np.ndarray, disturbed: bool, period: float
    ) -> Switching:
        """`alpha`, `active`, `at_home`: (ticks,) arrays; `disturbed`: whether a disturbance was due."""
        high = alpha >= FALSE_ALARM
        if not disturbed or not active.any():
            crossings = int(np.count_nonzero(np.diff(high.astype(int), prepend=0) > 0))
            failure = "false switch" if crossings else ("not disturbed" if disturbed else None)
            return cls(
                None, None, None, None, None, crossings, float(alpha.max(initial=0.0)), failure,
                as_in_paper=failure is None, decided=crossings > 0,
            )  # fmt: skip
        onset = int(np.argmax(active))
        end = onset + int(np.count_nonzero(active))
        before = high[:onset]
        crossings = int(np.count_nonzero(np.diff(before.astype(int), prepend=0) > 0))
        detected = _first(alpha >= DETECTED, onset, end + DETECTION_TICKS)
        home = resumed = let_go = None
        as_in_paper, patience = False, round(RESUME_SECONDS / period) + 1
        if detected is not None:
            start = max(detected, end)
            let_go = _first(~high, start, len(alpha))
            home = _first(at_home, start, len(alpha) if let_go is None else let_go)
            if home is not None:
                resumed = _first(alpha <= RESUMED, home, home + patience)
            homes, low = np.flatnonzero(at_home[start:]) + start, np.append(np.flatnonzero(alpha <= RESUMED), np.inf)
            as_in_paper = bool(np.any(low[np.searchsorted(low, homes)] < homes + patience))
        failure = (
            "false switch" if crossings
            else "not detected" if detected is None
            else "not returned" if home is None
            else "not resumed" if resumed is None
            else None
        )  # fmt: skip
        decided = bool(crossings) or (
            not active[-1]
            and (
                len(alpha) >= end + DETECTION_TICKS if detected is None
                else let_go is not None if home is None
                else resumed is not None or len(alpha) >= home + patience
            )
        )  # fmt: skip
        return cls(
            onset,
            end,
            detected,
            home,
            resumed,
            crossings,
            float(alpha[:onset].max(initial=0.0)),
            failure,
            as_in_paper,
            decided,
        )

    @property
    def ticks_disturbed(self) -> int:
        """From the onset until the network has the arm again; else the disturbance alone."""
        if self.onset is None or self.end is None:
            return 0
        return (self.resumed if self.resumed is not None else self.end) - self.onset


def _first(condition: np.ndarray, start: int, stop: int) -> int | None:
    """First index in [start, stop) at which `condition` holds."""
    hits = np.flatnonzero(condition[start:stop])
    return start + int(hits[0]) if len(hits) else None
