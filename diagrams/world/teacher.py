"""The scripted teacher: one demonstration of both subtasks in physics, for one grid position and one vacant spot."""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator

from diagrams.world import trajectory
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import CAN_HALF_HEIGHT, SPOTS, other_spot
from diagrams.world.station import PickPlaceStation
from diagrams.world.task import TaskMonitor
from models.data.recording import Recording


@dataclass(frozen=True)
class Setup:
    """What one demonstration starts from."""

    name: str  # of the demonstration
    grid_index: tuple[int, int]  # of the can to pick
    vacant: str
    turn: float  # of the can to pick about its axis, rad
    seed: tuple[int, int]  # samples how the arm is pushed off its path


def setups(world: World, seed: int) -> list[Setup]:
    """All positions times both spots, in a fixed order; `seed` samples the rest."""
    side = range(world.grid.count)
    places = [((i, j), vacant) for i in side for j in side for vacant in SPOTS]
    turns = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(places))
    return [Setup(f"demo_{n}", cell, vacant, float(turns[n]), (seed, n)) for n, (cell, vacant) in enumerate(places)]


class Teacher:
    """The station with the scripted teacher; built once, its Context is fresh for each demonstration."""

    def __init__(self, world: World):
        self._world, self._station = world, PickPlaceStation(world)
        self._simulator = Simulator(self._station)
        self._hand = HandKinematics(world)

    def commands(self, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
        """(T, 8) the commands to demonstrate, and what is added to them to push the arm off its path, rad and m.

        Raises InputError for a can that the arm cannot reach.
        """
        goals = [*self._world.grid.position(*setup.grid_index), CAN_HALF_HEIGHT], self._station.spot(setup.vacant)
        rng = np.random.default_rng(setup.seed)
        actions, deviations = [], []
        for subtask, goal in enumerate(goals, start=1):
            waypoints = trajectory.subtask_waypoints(self._world, self._hand, np.asarray(goal), subtask)
            steps = trajectory.SUBTASK_STEPS[subtask - 1]
            actions.append(trajectory.commands(waypoints, steps))
            deviations.append(trajectory.deviations(waypoints, steps, rng))
        return np.vstack(actions), np.vstack(deviations)

    def demonstrate(self, setup: Setup) -> Recording:
        """Runs one demonstration; raises InputError as `commands` does."""
        world, station, simulator = self._world, self._station, self._simulator
        can_xy = world.grid.position(*setup.grid_index)
        actions, deviations = self.commands(setup)
        simulator.reset_context(station.CreateDefaultContext())
        context = simulator.get_mutable_context()
        station.set_scene(context, can_xy, setup.vacant, setup.turn)
        desired = station.GetInputPort("desired_posture")
        desired.FixValue(context, world.initial_posture)
        simulator.Initialize()
        postures, images = [], []
        for k, command in enumerate(actions + deviations):
            simulator.AdvanceTo(k * world.timing.period)
            postures.append(station.GetOutputPort("posture").Eval(context))
            images.append(station.GetOutputPort("rgb_image").Eval(context).data[:, :, :3].copy())
            desired.FixValue(context, command)
        simulator.AdvanceTo(len(actions) * world.timing.period)
        place, neighbour = station.spot(setup.vacant), station.spot(other_spot(setup.vacant))
        cans, posture = (station.GetOutputPort(port).Eval(context) for port in ("can_poses", "posture"))
        monitor = TaskMonitor(place, neighbour, world.initial_posture, world.timing.period)
        return Recording(
            name=setup.name,
            rgb=np.array(images),
            posture=np.array(postures),
            actions=actions,
            can_xy=can_xy,
            vacant=setup.vacant,
            grid_index=setup.grid_index,
            subtask_starts=(0, trajectory.SUBTASK_STEPS[0]),
            split="train" if world.grid.is_training(*setup.grid_index) else "valid",
            success=monitor.success(cans, np.array([*postures, posture]), station.finger_gap(context)),
        )
