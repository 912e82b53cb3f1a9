"""One displacement of the arm at one moment of an undisturbed run, in the real closed loop."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.switching import GUARD
from diagrams.world.collisions import CollisionChecker
from diagrams.world.names import ARM_JOINTS, CANS
from diagrams.world.task import lifted
from models.errors import InputError

PATIENCE = 30.0  # s, in which the moment must come


class GuardProbe:
    """alpha after a displacement of the arm, at one moment of one undisturbed episode."""

    def __init__(self, rollout: Rollout, episode: Episode, level: float, ticks: int):
        """Runs `episode` until the hand is nearer to the can than `level` (m), and keeps that state.

        `ticks`: over how many the largest alpha is taken. Raises InputError where the moment does not come, or alpha is
        high before.
        """
        self._rollout, self._ticks = rollout, ticks
        self._period = rollout.world.timing.period
        # Half a plant step before a tick: else the servo pulls the arm back before its posture is sampled.
        self._before = 0.5 * rollout.world.timing.time_step
        rollout.prepare(episode)
        station, simulator = rollout.station, rollout.simulator
        context = simulator.get_mutable_context()
        distance = station.GetOutputPort("approach_distance")
        for k in range(round(PATIENCE / self._period)):
            simulator.AdvanceTo((k + 1) * self._period - self._before)
            if self._alpha(context) >= GUARD:
                raise InputError(
                    f"the run is in mode return {context.get_time():.1f} s after its start: choose another --seed"
                )
            if distance.Eval(station.GetMyContextFromRoot(context))[0] < level:
                break
        else:
            raise InputError(
                f"the hand does not come within {level} m of the can in {PATIENCE:g} s: choose a larger --level"
            )
        self.tick = k
        self._kept = context.Clone()
        plant_context = station.plant.GetMyContextFromRoot(self._kept)
        self.joints = station.plant.GetPositions(plant_context, station.arm).copy()
        self._checker = CollisionChecker(gap=0.0)
        cans = station.GetOutputPort("can_poses").Eval(station.GetMyContextFromRoot(self._kept))
        if lifted(cans):
            raise InputError(f"{CANS[0]} is already in the hand {level} m before it: choose a larger --level")
        self._checker.set_scene(cans[4:6], episode.vacant)
        self._lower = station.plant.GetPositionLowerLimits()[:ARM_JOINTS]
        self._upper = station.plant.GetPositionUpperLimits()[:ARM_JOINTS]

    def possible(self, displacement: np.ndarray) -> bool:
        """Whether the arm, displaced by `displacement` (7, rad), is within its limits and touches nothing."""
        joints = self.joints + displacement
        within = np.all(joints >= self._lower) and np.all(joints <= self._upper)
        return bool(within) and self._checker.first_touch(joints) is None

    def __call__(self, displacement: np.ndarray) -> tuple[float, float]:
        """Largest alpha and largest error l_n / r_n over the ticks after a displacement (7, rad)."""
        simulator, station, controller = self._rollout.simulator, self._rollout.station, self._rollout.controller
        simulator.reset_context(self._kept.Clone())
        context = simulator.get_mutable_context()
        plant_context = station.plant.GetMyMutableContextFromRoot(context)
        station.plant.SetPositions(plant_context, station.arm, self.joints + displacement)
        alphas, errors = [], []
        for k in range(1, self._ticks + 1):
            simulator.AdvanceTo((self.tick + k + 1) * self._period - self._before)
            alphas.append(self._alpha(context))
            errors.append(np.max(controller.GetOutputPort("errors").Eval(controller.GetMyContextFromRoot(context))))
        return max(alphas), float(max(errors))

    def _alpha(self, context: Context) -> float:
        controller = self._rollout.controller
        return float(controller.GetOutputPort("alpha").Eval(controller.GetMyContextFromRoot(context))[0])
