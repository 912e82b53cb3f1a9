"""One displacement of the arm at one moment of an undisturbed run, in the real closed loop."""

import numpy as np
from pydrake.systems.framework import System

from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.switching import GUARD
from diagrams.world.collisions import CollisionChecker
from diagrams.world.names import ARM_JOINTS, CANS
from diagrams.world.station import controller_limits
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
        for k in range(round(PATIENCE / self._period)):
            simulator.AdvanceTo((k + 1) * self._period - self._before)
            if self._output(rollout.controller, "alpha")[0] >= GUARD:
                seconds = simulator.get_context().get_time()
                raise InputError(f"the run is in mode return {seconds:.1f} s after its start: choose another --seed")
            if self._output(station, "approach_distance")[0] < level:
                break
        else:
            raise InputError(
                f"the hand does not come within {level} m of the can in {PATIENCE:g} s: choose a larger --level"
            )
        self.tick, self._kept = k, simulator.get_context().Clone()
        self.joints = self._output(station, "posture")[:ARM_JOINTS].copy()
        cans = self._output(station, "can_poses")
        if lifted(cans):
            raise InputError(f"{CANS[0]} is already in the hand {level} m before it: choose a larger --level")
        self._checker = CollisionChecker(rollout.world, gap=0.0)
        self._checker.set_scene(cans[4:6], episode.vacant)
        self._lower, self._upper, _ = (limit[:ARM_JOINTS] for limit in controller_limits(station))

    def possible(self, displacement: np.ndarray) -> bool:
        """Whether the arm, displaced by `displacement` (7, rad), is within its limits and touches nothing."""
        joints = self.joints + displacement
        within = np.all(joints >= self._lower) and np.all(joints <= self._upper)
        return bool(within) and self._checker.first_touch(joints) is None

    def __call__(self, displacement: np.ndarray) -> tuple[float, float]:
        """Largest alpha and largest error l_n / mean_l_n over the ticks after a displacement (7, rad)."""
        simulator, station, controller = self._rollout.simulator, self._rollout.station, self._rollout.controller
        simulator.reset_context(self._kept.Clone())
        plant_context = station.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        station.plant.SetPositions(plant_context, station.arm, self.joints + displacement)
        alphas, errors = [], []
        for k in range(1, self._ticks + 1):
            simulator.AdvanceTo((self.tick + k + 1) * self._period - self._before)
            alphas.append(float(self._output(controller, "alpha")[0]))
            errors.append(float(np.max(self._output(controller, "errors"))))
        return max(alphas), max(errors)

    def _output(self, system: System, port: str) -> np.ndarray:
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self._rollout.simulator.get_context()))
