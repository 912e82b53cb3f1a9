"""Sampling: from a seed to an Episode. Everything that is random about an episode is sampled here."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry.optimization import HPolyhedron, VPolytope

from diagrams.episodes.episode import Episode
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS, is_fault, require_kind
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, IN_HAND, LIMIT_MARGIN, MOVED, SPOTS, other_spot
from diagrams.world.scenario import Scenario
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, HOVER, subtask_commands
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.manual_disturbance import MOVE
from systems.recoveries.registry import RECOVERIES

XY = tuple[float, float]  # m, world
UNLEARNED = (0.010, 0.020)  # distance of an unlearned position to the nearest trained one, m
# Distance to the goal at which the disturbance begins, m. Subtask 1: the fingers do not surround the can yet;
# subtask 2: the can does not touch the shelf yet.
ONSET_LEVELS = {1: (0.10, 0.20), 2: (0.04, 0.16)}
DEFLECTION_DEG = (15.0, 40.0)
DEFLECTED_JOINTS = (3, 7)  # how many joints, inclusive
DRAWS, LIVE_DRAWS = 2000, 100  # of a deflection; while somebody waits for it
STOP_TICKS = (15, 25)  # inclusive, B
HELD_TICKS = 10  # A: at the posture it was moved to
CAN_TAKEN_SHARE = 0.5  # of the disturbances B in subtask 2
MOVED_BY = (0.03, 0.06)  # how far a can is moved while the hand approaches it, m
FROM_START = 10.0  # m: a level that is above every distance, of what is so from the first tick on
ON_SHELF = 0.05  # m: how far from its spot the other can may be put
# Seeds of one purpose never meet those of another: see episode_seeds.
SEED_BASE = {
    "validation": 1_000_000, "evaluation": 2_000_000, "certificate": 3_000_000, "defeat": 4_000_000,
    "resumption": 5_000_000,
}  # fmt: skip
SEEDS_APART, SEED_BLOCKS = 10_000, 100


def episode_seeds(purpose: str, seed: int, count: int) -> list[int]:
    """Seeds of `count` episodes for a purpose of SEED_BASE; `seed` chooses one of 100 sets that share no episode.

    Raises InputError for a seed or a count beyond what belongs to the purpose.
    """
    if not 0 <= seed < SEED_BLOCKS:
        raise InputError(
            f"seed {seed} is outside of 0 to {SEED_BLOCKS - 1}, where {purpose} episodes are: choose another"
        )
    if not 1 <= count <= SEEDS_APART:
        raise InputError(
            f"{count} episodes are outside of 1 to {SEEDS_APART}, what one seed gives: choose another number"
        )
    base = SEED_BASE[purpose] + SEEDS_APART * seed
    return list(range(base, base + count))


@dataclass(frozen=True)
class Approach:
    """The demonstrated motion of a subtask: joint angles (n, 7) rad, distance to the goal (n,) m, where in words."""

    joints: np.ndarray
    distances: np.ndarray
    where: str

    def joints_at(self, level: float) -> np.ndarray:
        """(7,) rad: where the teacher is when the distance falls below `level` (m)."""
        below = np.flatnonzero(self.distances < level)
        if not len(below):
            raise InputError(
                f"the demonstrated motion of {self.where} does not come within {level:.3f} m of its goal: "
                "choose a disturbance.level above that"
            )
        return self.joints[below[0]]


class EpisodeSampler:
    """Samples episodes; keeps the models it needs (kinematics, collisions), no state between samples."""

    def __init__(self, world: World):
        self._world = world
        self._home = world.initial_posture[:ARM_JOINTS]
        self._hand = HandKinematics(world)
        self._checker = CollisionChecker(world)
        self._trained_area = HPolyhedron(VPolytope(world.grid.training_positions().T))

    def sample(
        self,
        seed: int,
        kind: str,
        can_xy: Sequence[float] | None = None,
        vacant: str | None = None,
        rnn: str = "lstm",
        detector: str = "recall",
        severity: float = 1.0,
    ) -> Episode:
        """The episode of `seed` under a disturbance of `kind`; of a fault, of that `severity`.

        `can_xy` (m, world) and `vacant` replace what would be sampled, without changing the rest. Raises InputError for
        a can that the arm cannot reach.
        """
        scene, experimenter = (np.random.default_rng([seed, stream]) for stream in (0, 1))
        sampled_xy, sampled_vacant = self.unlearned_position(scene), str(scene.choice(SPOTS))
        can_xy = sampled_xy if can_xy is None else (float(can_xy[0]), float(can_xy[1]))
        vacant = sampled_vacant if vacant is None else vacant
        other_spot(vacant)  # there is one
        try:
            self.require_reachable(can_xy)
        except InputError as error:
            if can_xy == sampled_xy:  # nobody gave it
                error.add_note(
                    f"it is a place of world.grid ({self._world.grid}): lower its spacing, or move its corner"
                )
            raise
        disturbance, clear = self._disturbance(experimenter, kind, can_xy, vacant)
        if disturbance.fault is not None:
            disturbance.severity = severity
        return Episode(seed, can_xy, vacant, disturbance, rnn, detector, clear)

    def episode(self, scenario: Scenario) -> Episode:
        """The episode that `scenario` gives, sampled where it leaves something open.

        Raises InputError as `sample` does.
        """
        given, rnn, detector = scenario.disturbance, scenario.label, DETECTORS.label(scenario.detector)
        kind = given.kind if given.level is None else "none"
        episode = self.sample(scenario.seed, kind, scenario.can, scenario.vacant, rnn, detector, given.severity)
        self._require_hands(scenario.hands)
        episode = replace(episode, hands=scenario.hands, recovery=RECOVERIES.label(scenario.recovery))
        if given.level is None or given.kind == "none":
            return episode
        for first in range(0, len(given.target or []), ARM_JOINTS):
            self._require_within("disturbance.target", (given.target or [])[first : first + ARM_JOINTS])
        if given.can_moved_to is not None:
            if getattr(given.fault, "moves", 0):
                self._require_on_shelf(given.can_moved_to, episode.vacant)
            else:
                self.require_reachable(given.can_moved_to)
        return replace(episode, disturbance=given, way_home_clear=None)

    def _require_hands(self, hands: HandsSchedule) -> None:
        """Raises InputError for a posture or a place that no hand can give; see HandsSchedule.check for the rest."""
        for _, kind, *target in hands.grip:
            if kind == MOVE:
                self._require_within("hands.grip", target)
        for _, *place in hands.can:
            self.require_reachable(place)

    def _require_within(self, name: str, target: list[float]) -> None:
        """Raises InputError unless the posture `target` (7, rad), called `name`, is within the joint limits."""
        if self._hand.margin(np.array(target)) < 0.0:
            raise InputError(
                f"{name} {target} rad is outside of the joint limits: "
                f"choose from {self._hand.lower.round(2).tolist()} to {self._hand.upper.round(2).tolist()}"
            )

    def _require_on_shelf(self, place: list[float], vacant: str) -> None:
        """Raises InputError unless the other can may be put at `place`, x and y, m, world."""
        spot = self._checker.spot(other_spot(vacant))[:2]
        if np.linalg.norm(np.array(place) - spot) > ON_SHELF:
            raise InputError(
                f"disturbance.can_moved_to {place} m is not on the shelf: choose a place within {ON_SHELF} m of "
                f"{spot.round(3).tolist()}"
            )

    def onset_posture(self, episode: Episode) -> np.ndarray:
        """(7,) rad: where the teacher is at the onset of the disturbance of `episode`, which has a level.

        Raises InputError for a level that the teacher does not come below.
        """
        given = episode.disturbance
        assert given.level is not None
        return self.approach(given.subtask, episode.can_xy, episode.vacant).joints_at(given.level)

    def require_reachable(self, can_xy: Sequence[float]) -> None:
        """Raises InputError unless the hand can hover over, grasp and lift a can at `can_xy` (m, world)."""
        if not np.all(np.isfinite(can_xy)):
            raise InputError(f"the can's position {can_xy} is not a pair of numbers: give x and y in metres")
        margin = 0.5 * self._world.grid.spacing
        lower, upper = self._world.grid.bounds[0] - margin, self._world.grid.bounds[1] + margin
        if np.any(np.asarray(can_xy) < lower) or np.any(np.asarray(can_xy) > upper):
            raise InputError(
                f"the can at ({can_xy[0]:.3f}, {can_xy[1]:.3f}) m is out of reach of what was taught: "
                f"choose x in [{lower[0]:.2f}, {upper[0]:.2f}] and y in [{lower[1]:.2f}, {upper[1]:.2f}]"
            )
        for height in (0.0, HOVER):
            self._hand.solve_ik(np.array([*can_xy, CAN_HALF_HEIGHT + GRASP_ABOVE_CENTRE + height]))

    def unlearned_position(self, rng: np.random.Generator) -> XY:
        """World x, y (m) in the trained positions' convex hull, 1.0 to 2.0 cm from the nearest of them."""
        lower, upper = self._world.grid.bounds
        for _ in range(10_000):
            xy = rng.uniform(lower, upper)
            if self.unlearned(xy):
                return float(xy[0]), float(xy[1])
        raise InputError(
            f"no place of the trained area is {UNLEARNED[0]} to {UNLEARNED[1]} m from the trained positions: "
            f"raise world.grid.spacing ({self._world.grid.spacing} m) or count ({self._world.grid.count})"
        )

    def unlearned(self, xy: np.ndarray) -> bool:
        """Whether a can may stand at `xy` (2,), m, world: see `unlearned_position`."""
        distance = np.linalg.norm(self._world.grid.training_positions() - xy, axis=1).min()
        return bool(UNLEARNED[0] <= distance <= UNLEARNED[1] and self._trained_area.PointInSet(xy))

    def _disturbance(
        self, rng: np.random.Generator, kind: str, can_xy: XY, vacant: str
    ) -> tuple[DisturbanceSpec, bool | None]:
        """And whether the straight way home from it is clear; None: the arm is not disturbed."""
        # First what the scene has no say in, so that another can or spot leaves it as it is.
        require_kind(kind)
        fault = FAULTS[kind] if is_fault(kind) else None
        fixed = 1 if kind == MOVED else None if fault is None else fault.subtask
        subtask = int(rng.integers(1, 3)) if fixed is None else fixed
        hold = int(rng.integers(*STOP_TICKS, endpoint=True))
        taken = subtask == 2 and rng.uniform() < CAN_TAKEN_SHARE
        elsewhere = self.unlearned_position(rng)
        if kind == "none":
            return DisturbanceSpec(), None
        level = float(rng.uniform(*ONSET_LEVELS[subtask]))
        if kind == MOVED:
            return DisturbanceSpec(MOVED, level, subtask=1, can_moved_to=list(self._moved(rng, can_xy))), None
        if fault is not None:
            return self._fault(rng, kind, fault, level, hold, subtask, can_xy, vacant), None
        approach = self.approach(subtask, can_xy, vacant)
        start = approach.joints_at(level)
        if kind == "B":
            given, left_at = DisturbanceSpec("B", level, None, hold, subtask, list(elsewhere) if taken else None), start
        else:
            left_at = self._deflected(rng, start, approach)
            given = DisturbanceSpec("A", level, left_at.tolist(), HELD_TICKS, subtask)
        return given, self.way_home_clear(given, left_at, vacant)

    def way_home_clear(self, given: DisturbanceSpec, left_at: np.ndarray, vacant: str) -> bool:
        """Whether the straight way home from `left_at` (7, rad) is clear, in the scene of the last `approach`."""
        if given.can_moved_to is not None:  # it goes home without the can
            self._checker.set_scene(np.array(given.can_moved_to), vacant, self._world.closed_opening)
        return self._checker.path_touches(left_at, self._home) is None

    def _fault(
        self, rng: np.random.Generator, kind: str, fault, level: float, hold: int, subtask: int, can_xy: XY, vacant: str
    ) -> DisturbanceSpec:
        """What a fault of the class `fault` does at severity 1; the rest of its chance is in its system."""
        given = DisturbanceSpec(kind, FROM_START if fault.from_start else level, subtask=subtask)
        given.hold_ticks = HELD_TICKS if fault.targets else 0 if fault.lasts else hold
        if (by := getattr(fault, "moved_by", None)) is not None:
            given.can_moved_to = list(self._beside(rng, vacant, by) if fault.moves else self._moved(rng, can_xy, by))
        if fault.targets:
            approach = self.approach(subtask, can_xy, vacant)
            targets = [self._deflected(rng, approach.joints_at(level), approach)]
            while len(targets) < fault.targets:  # somewhere on the way home, or at home
                start = fault.home_share * self._home + (1.0 - fault.home_share) * targets[-1]
                targets.append(self._deflected(rng, start, approach))
            given.target = np.concatenate(targets).tolist()
        return given

    def _beside(self, rng: np.random.Generator, vacant: str, by: tuple[float, float]) -> XY:
        """World x, y (m) `by` from where the other can stands on the shelf, not nearer to the vacant spot."""
        stands, free = self._checker.spot(other_spot(vacant))[:2], self._checker.spot(vacant)[:2]
        outward = np.arctan2(*(stands - free)[::-1])
        angle, distance = outward + rng.uniform(-np.pi / 2, np.pi / 2), rng.uniform(*by)
        x, y = stands + distance * np.array([np.cos(angle), np.sin(angle)])
        return float(x), float(y)

    def _moved(self, rng: np.random.Generator, can_xy: XY, by: tuple[float, float] = MOVED_BY) -> XY:
        """World x, y (m) `by` from `can_xy`, in the trained positions' convex hull."""
        for _ in range(10_000):
            angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(*by)
            xy = np.array(can_xy) + distance * np.array([np.cos(angle), np.sin(angle)])
            if self._trained_area.PointInSet(xy):
                return float(xy[0]), float(xy[1])
        raise InputError(
            f"no place of the trained area is {by[0]} to {by[1]} m from the can at {can_xy}: "
            "choose another place with --can"
        )

    def approach(self, subtask: int, can_xy: XY, vacant: str) -> Approach:
        """The demonstrated motion in that scene, which from then on is the one that `comes_freely` asks about."""
        self._checker.set_scene(can_xy if subtask == 1 else None, vacant, self._world.opening)
        centre = np.array([*can_xy, CAN_HALF_HEIGHT]) if subtask == 1 else self._checker.spot(vacant)
        joints = subtask_commands(self._world, self._hand, centre, subtask)[:, :ARM_JOINTS]
        # Subtask 2 measures from the held can.
        offset = [0, 0, 0] if subtask == 1 else [0, 0, -GRASP_ABOVE_CENTRE]
        distances = [np.linalg.norm(self._hand.grasp_position(row) + offset - centre) for row in joints]
        where = f"subtask {subtask} with the can at ({can_xy[0]:.3f}, {can_xy[1]:.3f}) m, the {vacant} spot vacant"
        return Approach(joints, np.array(distances), where)

    def _deflected(self, rng: np.random.Generator, start: np.ndarray, approach: Approach) -> np.ndarray:
        """See `_deflection`; raises InputError where there is none."""
        target = self._deflection(rng, start, DRAWS)
        if target is None:
            raise InputError(
                f"no posture {DEFLECTION_DEG[0]:g} to {DEFLECTION_DEG[1]:g} deg off was found to which the arm comes "
                f"freely, in {approach.where}: give disturbance.target"
            )
        return target

    def _deflection(self, rng: np.random.Generator, start: np.ndarray, draws: int) -> np.ndarray | None:
        """(7,) rad: several joints 15 to 40 deg off `start`; sampled again until the path there is clear, or None."""
        for _ in range(draws):
            count = rng.integers(*DEFLECTED_JOINTS, endpoint=True)
            joints = rng.choice(ARM_JOINTS, size=count, replace=False)
            offset = np.zeros(ARM_JOINTS)
            offset[joints] = rng.choice([-1.0, 1.0], size=count) * np.deg2rad(rng.uniform(*DEFLECTION_DEG, size=count))
            target = start + offset
            if self.comes_freely(start, target):
                return target
        return None

    def pushed_away(self, rng: np.random.Generator, posture: np.ndarray, can_poses: np.ndarray) -> np.ndarray:
        """(7,) rad: as the target of disturbance A, for an arm that is at `posture` (8,), rad and m, among `can_poses`.

        `can_poses` (14,): as PickPlaceStation gives them. Raises InputError where the arm cannot be moved.
        """
        start = posture[:ARM_JOINTS]
        closed = bool(posture[ARM_JOINTS] < self._world.close_below)
        between = np.linalg.norm(self._hand.grasp_position(start) - can_poses[4:7]) < IN_HAND
        self._checker.set_poses(can_poses, held=closed and bool(between))
        wait = "cannot be moved away: wait, or put the can elsewhere"
        if (name := self._checker.first_touch(start)) is not None:
            raise InputError(f"the arm is so near to the {name.replace('_', ' ')} that it {wait}")
        target = self._deflection(rng, start, LIVE_DRAWS)
        if target is None:
            raise InputError(f"no posture was found near by to which the arm comes freely, so that it {wait}")
        return target

    def comes_freely(self, start: np.ndarray, target: np.ndarray) -> bool:
        """Whether the arm can be moved from `start` to `target` (7, rad) within its limits, and touches nothing.

        In the scene of the last `approach`.
        """
        lower, upper = self._hand.lower + LIMIT_MARGIN, self._hand.upper - LIMIT_MARGIN
        within = np.all(target >= lower) and np.all(target <= upper)
        return bool(within) and self._checker.path_touches(start, target) is None
