"""Perturbations: one family that holds both of the paper's disturbances, for the search of the smallest that defeats.

The arm is deflected by `size_deg` along a direction, from a moment on, and held there for a while; or it is stopped
alone; or stopped while the can is taken out of its hand and put elsewhere. Defeated means one of DEFEATS
(diagrams/episodes/switching.py). A perturbation that is not detected is no defeat where the task is done all the same:
the network has coped with it. One whose forced path would touch the scene is none, as in the sampling of episodes.

What is minimised: the magnitude in [0, 1] where the controller is defeated, else 1 + the least robustness of what is
required of the switching (`least_robustness`), at most 1; negative is a defeat, or a perturbation that the network has
coped with, which is as far from one as it is from being noticed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.record import Record
from diagrams.episodes.sampling import ONSET_LEVELS
from diagrams.episodes.switching import DEFEATS
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.disturbance import CAN_TAKEN_TICKS, DisturbanceSpec
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, LIMIT_MARGIN
from diagrams.world.requirements import SIGNALS, robustness_of
from systems.disturbance import MOVE_TICKS

MAX_SIZE_DEG = 60.0  # norm over the joints
HOLD_TICKS = (0, 25)
FORMS = ("deflected", "stopped", "taken")
REQUIRED = ("notices", "returns", "resumes", "no_later_switch")  # of requirements.stl: one of DEFEATS breaks one
NEARLY = 0.05  # from 0 or 1


@dataclass(frozen=True)
class Perturbation:
    """A disturbance of one of the scenes searched, and how large it is."""

    scene: int  # index
    disturbance: DisturbanceSpec
    size_deg: float  # norm over the joints; 0 where the arm is stopped

    @property
    def form(self) -> str:
        """One of FORMS."""
        if self.disturbance.kind == "A":
            return "deflected"
        return "stopped" if self.disturbance.can_moved_to is None else "taken"

    @property
    def ticks(self) -> int:
        """How long it lasts."""
        return self.disturbance.hold_ticks + (MOVE_TICKS if self.disturbance.kind == "A" else 0)

    @property
    def magnitude(self) -> float:
        """How large it is, in [0, 1]: half of it the size, half the length."""
        return 0.5 * self.size_deg / MAX_SIZE_DEG + 0.5 * self.ticks / (MOVE_TICKS + HOLD_TICKS[1])


@dataclass(frozen=True)
class NominalRun:
    """The undisturbed run of a scene, a row a tick."""

    distances: dict[int, np.ndarray]  # by subtask: (n,) to the goal, m
    commands: np.ndarray  # (n, 7) the command that holds at that tick, rad

    @classmethod
    def of(cls, record: Record, hand: HandKinematics, place: np.ndarray) -> Self:
        """From an undisturbed run's record; `place` (3,): centre of the can on its spot, m, world."""
        can = record.can_poses[:, 4:7]
        grasp = np.array([hand.grasp_position(joints[:ARM_JOINTS]) for joints in record.posture])
        distances = {1: np.linalg.norm(grasp - can, axis=1), 2: np.linalg.norm(can - place, axis=1)}
        return cls(distances, record.desired_posture[:, :ARM_JOINTS])

    def command_at(self, subtask: int, level: float) -> np.ndarray | None:
        """(7,) rad: the command when the distance first falls below `level` (m); None where it does not."""
        below = np.flatnonzero(self.distances[subtask] < level)
        return self.commands[max(int(below[0]) - 1, 0)] if len(below) else None


class PerturbationSpace:
    """Turns a sampler's proposals into perturbations of some scenes, or says that they are none."""

    def __init__(self, world: World, scenes: Sequence[Episode], records: Sequence[Record]):
        """`records`: of the scenes' undisturbed runs."""
        self._scenes, self._grid = scenes, world.grid.bounds
        hand = HandKinematics(world)
        self._lower, self._upper = hand.lower + LIMIT_MARGIN, hand.upper - LIMIT_MARGIN
        self._checker = CollisionChecker(world)
        places = [self._checker.spot(scene.vacant) for scene in scenes]
        self.runs = [NominalRun.of(record, hand, place) for record, place in zip(records, places, strict=True)]

    def propose(self, suggest: Any) -> Perturbation | None:
        """What a sampler proposes; None where no experimenter could do it.

        The moment does not come, or the arm would leave its limits or touch the scene on its path there. The first half
        of the moments is subtask 1, the second subtask 2, each from the earliest distance to the goal to the latest.

        `suggest`: as optuna's Trial.suggest_float. Numbers only: CMA-ES knows no choices.
        """
        form = FORMS[int(3 * suggest("form", 0.0, 0.9999))]
        size = suggest("size_deg", 0.0, MAX_SIZE_DEG)
        direction = np.array([suggest(f"direction_{j + 1}", -1.0, 1.0) for j in range(ARM_JOINTS)])
        moment = suggest("moment", 0.0, 0.9999)
        hold = round(suggest("hold_ticks", *map(float, HOLD_TICKS)))
        scene = int(len(self._scenes) * suggest("scene", 0.0, 0.9999))
        place = np.array([suggest("place_x", 0.0, 1.0), suggest("place_y", 0.0, 1.0)])
        subtask = 1 if moment < 0.5 else 2
        earliest, latest = ONSET_LEVELS[subtask][::-1]
        level = float(earliest + (latest - earliest) * (2.0 * moment % 1.0))
        offset = np.zeros(ARM_JOINTS)
        if form == "deflected":  # by nothing where there is no direction
            offset = np.deg2rad(size) * direction / max(float(np.linalg.norm(direction)), 1e-9)
        target = self._target(scene, subtask, level, offset)
        if target is None:
            return None
        if form == "deflected":
            return Perturbation(scene, DisturbanceSpec("A", level, target.tolist(), hold, subtask), size)
        if form == "stopped" or subtask == 1:  # before subtask 2 there is no can in the hand
            return Perturbation(scene, DisturbanceSpec("B", level, None, max(hold, 1), subtask), 0.0)
        corner, opposite = self._grid
        moved = (corner + place * (opposite - corner)).tolist()
        return Perturbation(scene, DisturbanceSpec("B", level, None, max(hold, CAN_TAKEN_TICKS), subtask, moved), 0.0)

    def _target(self, scene: int, subtask: int, level: float, offset: np.ndarray) -> np.ndarray | None:
        """(7,) rad: where the arm is moved by `offset` (7, rad); None where that is no perturbation."""
        start = self.runs[scene].command_at(subtask, level)
        if start is None:
            return None
        target = start + offset
        if np.any(target < self._lower) or np.any(target > self._upper):
            return None
        episode = self._scenes[scene]
        self._checker.set_scene(episode.can_xy if subtask == 1 else None, episode.vacant)
        return target if self._checker.path_touches(start, target) is None else None


def judge(
    perturbation: Perturbation, outcome: Outcome, record: Record, period: float, gamma: float
) -> tuple[str | None, float]:
    """The kind of defeat (None without one) and what is minimised; `gamma`: threshold of the errors; `period`: s."""
    failure = outcome.switch_failure
    if failure in DEFEATS and not (failure == "not detected" and outcome.success):
        return failure, perturbation.magnitude
    return None, 1.0 + min(abs(least_robustness(record, period, gamma)), 1.0)


def least_robustness(record: Record, period: float, gamma: float) -> float:
    """Of the requirements that a defeat breaks, the least; see diagrams/world/requirements.stl.

    Alpha is as good as 0 or 1 where the error is not near the threshold. Beyond NEARLY of either it is continued by the
    decades between the two, which changes the side of no bound in the requirements.
    """
    signals = record.signals.copy()
    alpha, decades = signals[:, SIGNALS.index("alpha")], np.log10(np.maximum(record.errors.max(axis=1), 1e-12) / gamma)
    alpha += np.where(alpha > 1.0 - NEARLY, np.maximum(decades, 0.0), 0.0)
    alpha += np.where(alpha < NEARLY, np.minimum(decades, 0.0), 0.0)
    found = robustness_of(signals, period)
    return min(found[name] for name in REQUIRED)
