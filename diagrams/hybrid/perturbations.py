"""Pushes: one family of disturbances that holds both of the paper's, for the search of the smallest one that defeats the controller.

The arm is moved by `size` (deg, norm over the joints) along a direction, from a moment on, and held there for a while; or it is stopped alone; or
stopped while the can is taken out of its hand and put elsewhere. Defeated means: not detected, not returned or not resumed (diagrams/episodes/episode.py).
A push that is not detected is no defeat where the task is done all the same: the network has coped with it. As in the draws, a push whose forced
way or straight way home would touch the scene is none.

What is minimised: the magnitude in [0, 1] where the controller is defeated, else 1 + its margin in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.record import Record
from diagrams.episodes.sampling import LIMIT_MARGIN, ONSET_LEVELS
from diagrams.episodes.switching import DETECTION_TICKS, GUARD, RESUME_SECONDS
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.disturbance import CAN_TAKEN_TICKS, Disturbance
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS

DEFEATS = ("not detected", "not returned", "not resumed")
MAX_SIZE_DEG = 60.0  # norm over the joints
MOVE_TICKS = 8  # systems/disturbance.py
HOLD_TICKS = (0, 25)
FORMS = ("push", "stop", "taken")
DECADES = 2.0  # an error so many powers of ten from the threshold has the whole margin


@dataclass(frozen=True)
class Push:
    """A disturbance as it is searched for.

    `form`: one of FORMS; `size_deg` and `direction` count for a push alone. `moment` in [0, 1): the first half is subtask 1, the second
    subtask 2, each from the earliest distance to the goal to the latest. `scene`: which of the scenes searched; `place` (2,) in [0, 1): where
    a can that is taken is put, as shares of the grid.
    """

    form: str
    size_deg: float
    direction: tuple[float, ...]  # (7,), any length
    moment: float
    hold_ticks: int
    scene: int = 0
    place: tuple[float, float] = (0.5, 0.5)

    @classmethod
    def propose(cls, suggest: Any, scenes: int) -> Push:
        """What a sampler proposes; `suggest`: as optuna's Trial.suggest_float. Numbers only: CMA-ES knows no choices."""
        form = FORMS[int(3 * suggest("form", 0.0, 0.9999))]
        size = suggest("size_deg", 0.0, MAX_SIZE_DEG)
        direction = tuple(suggest(f"direction_{j + 1}", -1.0, 1.0) for j in range(ARM_JOINTS))
        moment = suggest("moment", 0.0, 0.9999)
        hold = round(suggest("hold_ticks", *map(float, HOLD_TICKS)))
        scene = int(scenes * suggest("scene", 0.0, 0.9999))
        place = suggest("place_x", 0.0, 1.0), suggest("place_y", 0.0, 1.0)
        if form == "push":
            return cls(form, size, direction, moment, hold, scene)
        if form == "stop" or moment < 0.5:  # before subtask 2 there is no can in the hand
            return cls("stop", 0.0, (0.0,) * ARM_JOINTS, moment, max(hold, 1), scene)
        return cls(form, 0.0, (0.0,) * ARM_JOINTS, moment, max(hold, CAN_TAKEN_TICKS), scene, place)

    @property
    def subtask(self) -> int:
        """1 or 2."""
        return 1 if self.moment < 0.5 else 2

    @property
    def level(self) -> float:
        """Distance to the goal at which it begins, m."""
        near, far = ONSET_LEVELS[self.subtask]
        return float(far + (near - far) * (2.0 * self.moment % 1.0))

    @property
    def offset(self) -> np.ndarray:
        """(7,) rad, by which the arm is moved; nothing along no direction."""
        direction = np.asarray(self.direction)
        return np.deg2rad(self.size_deg) * direction / max(float(np.linalg.norm(direction)), 1e-9)

    @property
    def ticks(self) -> int:
        """How long it lasts."""
        return self.hold_ticks + (MOVE_TICKS if self.form == "push" else 0)

    @property
    def magnitude(self) -> float:
        """How large it is, in [0, 1]: half of it the size, half the length."""
        return 0.5 * self.size_deg / MAX_SIZE_DEG + 0.5 * self.ticks / (MOVE_TICKS + HOLD_TICKS[1])


@dataclass(frozen=True)
class NominalRun:
    """The undisturbed run of the scene, for the postures at the moments: a row a tick for each subtask."""

    distances: dict[int, np.ndarray]  # by subtask: to the goal, m
    commands: dict[int, np.ndarray]  # by subtask: (n, 7) the command that holds at that tick, rad

    @classmethod
    def of(cls, record: Record, hand: HandKinematics, place: np.ndarray) -> NominalRun:
        """From an undisturbed run's record; `place` (3,): centre of the can on its spot, m, world."""
        can = record.can_poses[:, 4:7]
        grasp = np.array([hand.grasp_position(joints[:ARM_JOINTS]) for joints in record.posture])
        commands = record.desired_posture[:, :ARM_JOINTS]
        return cls(
            {1: np.linalg.norm(grasp - can, axis=1), 2: np.linalg.norm(can - place, axis=1)}, {1: commands, 2: commands}
        )

    def command_at(self, subtask: int, level: float) -> np.ndarray | None:
        """(7,) rad: the command when the distance first falls below `level` (m); None where it does not."""
        below = np.flatnonzero(self.distances[subtask] < level)
        return self.commands[subtask][max(int(below[0]) - 1, 0)] if len(below) else None


class PushBuilder:
    """Turns a Push into a disturbance of one scene, or says that it is none."""

    def __init__(self, world: World, scene: Episode, nominal: NominalRun):
        self._scene, self._nominal = scene, nominal
        self._home = world.initial_posture[:ARM_JOINTS]
        self._grid = world.grid.bounds
        hand = HandKinematics(self._home)
        self._lower, self._upper = hand.lower + LIMIT_MARGIN, hand.upper - LIMIT_MARGIN
        self._clearance = CollisionChecker()

    def disturbance(self, push: Push) -> Disturbance | None:
        """None where the moment does not come, or the arm would leave its limits or touch the scene on its way there or home."""
        start = self._nominal.command_at(push.subtask, push.level)
        if start is None:
            return None
        target = start + push.offset
        if np.any(target < self._lower) or np.any(target > self._upper):
            return None
        self._clearance.set_scene(self._scene.can_xy if push.subtask == 1 else None, self._scene.vacant)
        for way in ((start, target), (target, self._home)):
            if self._clearance.path_touches(*way) is not None:
                return None
        if push.form == "push":
            joints = tuple(float(q) for q in target)
            return Disturbance("A", push.subtask, push.level, joints, push.hold_ticks)
        if push.form == "stop":
            return Disturbance("B", push.subtask, push.level, None, push.hold_ticks)
        corner, opposite = self._grid
        x, y = corner + np.asarray(push.place) * (opposite - corner)
        return Disturbance("B", push.subtask, push.level, None, push.hold_ticks, (float(x), float(y)))


def judge(push: Push, outcome: Outcome, record: Record, period: float, gamma: float) -> tuple[str | None, float]:
    """The kind of defeat (None without one) and what is minimised; `gamma`: the threshold of the record's errors, `period` in s."""
    failure = outcome.switch_failure if outcome.switch_failure in DEFEATS else None
    if failure == "not detected" and outcome.success:
        failure = None
    if failure is not None:
        return failure, push.magnitude
    margins = [1.0]
    active = np.flatnonzero(record.active)
    if len(active):
        until = active[-1] + 1 + DETECTION_TICKS
        worst = record.errors.max(axis=1)
        margins.append(_decades(worst[active[0] : until].max(), gamma))
        # How near the recall came to fitting again before the arm was at home.
        if outcome.returned and outcome.return_s is not None:
            home = active[-1] + 1 + round(outcome.return_s / period)
            away = np.flatnonzero(record.alpha[: home + 1] >= GUARD)
            first = int(away[away >= active[0]][0])
            margins.append(_decades(worst[first : home + 1].min(), gamma))
    if outcome.detection_delay_s is not None:
        margins.append(1.0 - outcome.detection_delay_s / ((push.ticks + DETECTION_TICKS) * period))
    if outcome.resume_s is not None:
        margins.append(1.0 - outcome.resume_s / RESUME_SECONDS)
    return None, 1.0 + float(np.clip(min(margins), 0.0, 1.0))


def _decades(error: float, gamma: float) -> float:
    return float(abs(np.log10(max(error, 1e-12) / gamma)) / DECADES)
