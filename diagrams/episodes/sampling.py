"""Draws: from a seed to an Episode. Everything that is random about an episode is drawn here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydrake.geometry.optimization import HPolyhedron, VPolytope

from diagrams.episodes.episode import DisturbanceDraw, Episode
from diagrams.world.collisions import CollisionChecker
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.scenario import SPOTS, Scenario, World
from diagrams.world.station import ARM_JOINTS, CAN_HALF_HEIGHT
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, HOVER, SUBTASK_STEPS, commands, subtask_waypoints
from models.errors import InputError

UNLEARNED = (0.010, 0.020)  # distance of an unlearned position to the nearest trained one, m
# Distance to the goal at which the disturbance begins, m. Subtask 1: the fingers do not surround the can yet; subtask 2: the can does not
# touch the shelf yet.
ONSET_LEVELS = {1: (0.10, 0.20), 2: (0.04, 0.16)}
DEFLECTION_DEG = (15.0, 40.0)
DEFLECTED_JOINTS = (3, 7)  # how many joints, inclusive
STOP_TICKS = (15, 25)  # inclusive
LIMIT_MARGIN = np.deg2rad(2.0)
CAN_TAKEN_SHARE = 0.5  # of the disturbances B in subtask 2
# Seeds of one purpose never meet those of another: see episode_seeds.
SEED_BASE = {"validation": 1_000_000, "evaluation": 2_000_000, "fitting": 3_000_000}
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


class EpisodeSampler:
    """Draws episodes; keeps the models it needs (kinematics, clearance), no state between draws."""

    def __init__(self, world: World):
        self._world = world
        self._hand = HandKinematics(world.initial_posture[:ARM_JOINTS])
        self._clearance = CollisionChecker()
        self._spots = _spot_centres(world)
        self._trained_area = HPolyhedron(VPolytope(world.grid.training_positions().T))

    def draw(
        self,
        seed: int,
        kind: str,
        can_xy: tuple[float, float] | None = None,
        vacant: str | None = None,
        rnn: str = "lstm",
        detector: str = "recall",
    ) -> Episode:
        """The episode of `seed`; `can_xy` (m, world) and `vacant` replace what would be drawn, without changing the rest of the draw.

        Raises InputError for a can that the arm cannot reach.
        """
        scene, experimenter = (np.random.default_rng([seed, stream]) for stream in (0, 1))
        drawn_xy, drawn_vacant = self.unlearned_position(scene), str(scene.choice(SPOTS))
        can_xy = drawn_xy if can_xy is None else (float(can_xy[0]), float(can_xy[1]))
        vacant = drawn_vacant if vacant is None else vacant
        if vacant not in SPOTS:
            raise InputError(f"there is no spot '{vacant}' on the shelf: choose one of {', '.join(SPOTS)}")
        self.require_reachable(can_xy)
        return Episode(seed, can_xy, vacant, self._disturbance(experimenter, kind, can_xy, vacant), rnn, detector)

    def episode(self, scenario: Scenario) -> Episode:
        """The episode that `scenario` gives, drawn where it leaves something open; raises InputError as `draw` does."""
        can_xy = (scenario.can[0], scenario.can[1]) if scenario.can else None
        given = scenario.experimenter
        if given.level is None:
            return self.draw(
                scenario.seed, scenario.disturbance, can_xy, scenario.vacant, scenario.rnn, scenario.detector
            )
        episode = self.draw(scenario.seed, "none", can_xy, scenario.vacant, scenario.rnn, scenario.detector)
        if scenario.disturbance == "none":
            return episode
        target = None if given.target is None else tuple(float(q) for q in given.target)
        if target is not None and self._hand.margin(np.array(target)) < 0.0:
            raise InputError(
                f"experimenter.target {given.target} rad is outside of the joint limits: "
                f"choose from {self._hand.lower.round(2).tolist()} to {self._hand.upper.round(2).tolist()}"
            )
        moved = None if given.can_moved_to is None else (float(given.can_moved_to[0]), float(given.can_moved_to[1]))
        if moved is not None:
            self.require_reachable(moved)
        draw = DisturbanceDraw(scenario.disturbance, given.subtask, given.level, target, given.hold_ticks, moved)
        return replace(episode, disturbance=draw)

    def require_reachable(self, can_xy: tuple[float, float]) -> None:
        """Raises InputError unless the hand can hover over, grasp and lift a can at `can_xy` (m, world)."""
        if not np.all(np.isfinite(can_xy)):
            raise InputError(f"the can's position {can_xy} is not a pair of numbers: give x and y in metres")
        lower, upper = self._world.grid.bounds
        margin = 0.5 * self._world.grid.spacing
        if np.any(np.asarray(can_xy) < lower - margin) or np.any(np.asarray(can_xy) > upper + margin):
            raise InputError(
                f"the can at ({can_xy[0]:.3f}, {can_xy[1]:.3f}) m is out of reach of what was taught: "
                f"choose x in [{lower[0] - margin:.2f}, {upper[0] + margin:.2f}] and y in [{lower[1] - margin:.2f}, {upper[1] + margin:.2f}]"
            )
        for height in (0.0, HOVER):
            self._hand.solve(np.array([*can_xy, CAN_HALF_HEIGHT + GRASP_ABOVE_CENTRE + height]))

    def unlearned_position(self, rng: np.random.Generator) -> tuple[float, float]:
        """World x, y (m) inside the trained area (the trained positions' convex hull), 1.0 to 2.0 cm from the nearest trained position."""
        lower, upper = self._world.grid.bounds
        trained = self._world.grid.training_positions()
        for _ in range(10_000):
            xy = rng.uniform(lower, upper)
            distance = np.linalg.norm(trained - xy, axis=1).min()
            if UNLEARNED[0] <= distance <= UNLEARNED[1] and self._trained_area.PointInSet(xy):
                return float(xy[0]), float(xy[1])
        raise InputError(
            f"no place of the trained area is {UNLEARNED[0]} to {UNLEARNED[1]} m from the trained positions: "
            f"raise world.grid.spacing ({self._world.grid.spacing} m) or count ({self._world.grid.count})"
        )

    def _disturbance(
        self, rng: np.random.Generator, kind: str, can_xy: tuple[float, float], vacant: str
    ) -> DisturbanceDraw:
        # First what the scene has no say in, so that another can or spot leaves it as it is.
        subtask = int(rng.integers(1, 3))
        hold = int(rng.integers(STOP_TICKS[0], STOP_TICKS[1] + 1))
        taken = subtask == 2 and rng.uniform() < CAN_TAKEN_SHARE
        elsewhere = self.unlearned_position(rng)
        if kind == "none":
            return DisturbanceDraw()
        level = self._onset_level(rng, subtask, can_xy, vacant)
        if kind == "B":
            return DisturbanceDraw("B", subtask, level, None, hold, elsewhere if taken else None)
        if kind == "A":
            target = self._deflected(rng, subtask, level, can_xy, vacant)
            return DisturbanceDraw("A", subtask, level, tuple(float(q) for q in target), 10)
        raise InputError(f"there is no disturbance '{kind}': choose none, A or B")

    def _onset_level(self, rng: np.random.Generator, subtask: int, can_xy: tuple[float, float], vacant: str) -> float:
        """m: drawn again until the straight way home from there touches nothing."""
        home = self._world.initial_posture[:ARM_JOINTS]
        self._clearance.set_scene(can_xy if subtask == 1 else None, vacant)
        for _ in range(100):
            level = float(rng.uniform(*ONSET_LEVELS[subtask]))
            if self._clearance.straight_way_touches(self._posture_at(subtask, level, can_xy, vacant), home) is None:
                return level
        raise InputError(
            f"no moment of subtask {subtask} with the can at ({can_xy[0]:.3f}, {can_xy[1]:.3f}) m, the {vacant} spot vacant, leaves a clear way "
            "home: choose another place with --can, or other models"
        )

    def _deflected(
        self, rng: np.random.Generator, subtask: int, level: float, can_xy: tuple[float, float], vacant: str
    ) -> np.ndarray:
        """(7,) rad: a posture 15 to 40 deg off in several joints; drawn again until the ways there and home touch nothing."""
        home = self._world.initial_posture[:ARM_JOINTS]
        start = self._posture_at(subtask, level, can_xy, vacant)
        self._clearance.set_scene(can_xy if subtask == 1 else None, vacant)
        lower, upper = self._hand.lower + LIMIT_MARGIN, self._hand.upper - LIMIT_MARGIN
        for _ in range(2000):
            count = rng.integers(DEFLECTED_JOINTS[0], DEFLECTED_JOINTS[1] + 1)
            joints = rng.choice(ARM_JOINTS, size=count, replace=False)
            offset = np.zeros(ARM_JOINTS)
            offset[joints] = rng.choice([-1.0, 1.0], size=count) * np.deg2rad(rng.uniform(*DEFLECTION_DEG, size=count))
            target = start + offset
            if np.any(target < lower) or np.any(target > upper):
                continue
            touches = self._clearance.straight_way_touches
            if (
                self._clearance.touched(target) is None
                and touches(start, target) is None
                and touches(target, home) is None
            ):
                return target
        raise InputError(
            f"no posture {DEFLECTION_DEG[0]:g} to {DEFLECTION_DEG[1]:g} deg off was found from which the arm comes home freely, for the can at "
            f"({can_xy[0]:.3f}, {can_xy[1]:.3f}) m, {level:.2f} m before the goal of subtask {subtask}: give experimenter.target"
        )

    def _posture_at(self, subtask: int, level: float, can_xy: tuple[float, float], vacant: str) -> np.ndarray:
        """(7,) rad: where the teacher would be when the approach distance falls below `level`."""
        centre = np.array([*can_xy, CAN_HALF_HEIGHT]) if subtask == 1 else self._spots[vacant]
        path = commands(subtask_waypoints(self._world, self._hand, centre, subtask), SUBTASK_STEPS[subtask - 1])[
            :, :ARM_JOINTS
        ]
        offset = [0, 0, 0] if subtask == 1 else [0, 0, -GRASP_ABOVE_CENTRE]  # subtask 2 measures from the held can
        for joints in path:
            if np.linalg.norm(self._hand.grasp_position(joints) + offset - centre) < level:
                return joints
        raise InputError(
            f"the demonstrated motion of subtask {subtask} does not come within {level:.3f} m of its goal: choose an experimenter.level above that"
        )


def _spot_centres(world: World) -> dict[str, np.ndarray]:
    from diagrams.world.station import PickPlaceStation

    station = PickPlaceStation(world, camera=False)
    return {name: station.spot(name) for name in SPOTS}
