"""Runs of the station alone, commanded tick by tick."""

import numpy as np
from pydrake.systems.analysis import Simulator

from diagrams.world.names import CAN_HALF_HEIGHT, CANS
from diagrams.world.trajectory import SUBTASK_STEPS, commands, subtask_waypoints


def start(station, can_xy=(0.53, 0.0), vacant="left") -> Simulator:
    """A fresh Context of `station` with the arm at rest at its initial posture, in a simulator."""
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.set_scene(context, np.array(can_xy), vacant)
    station.GetInputPort("desired_posture").FixValue(context, station.world.initial_posture)
    simulator.Initialize()
    return simulator


def play(station, simulator, rows, on_tick=None) -> None:
    """Commands `rows` (ticks, 8), one a tick, from now on; `on_tick(context)` after each."""
    period, context = station.world.timing.period, simulator.get_mutable_context()
    first = round(context.get_time() / period)
    for k, row in enumerate(rows, start=first + 1):
        station.GetInputPort("desired_posture").FixValue(context, row)
        simulator.AdvanceTo(k * period)
        if on_tick is not None:
            on_tick(context)


def taught(station, hand, can_xy, vacant, subtask) -> np.ndarray:
    """The teacher's commands (ticks, 8) for one subtask of a scene."""
    centre = [*can_xy, CAN_HALF_HEIGHT] if subtask == 1 else station.spot(vacant)
    waypoints = subtask_waypoints(station.world, hand, np.array(centre), subtask)
    return commands(waypoints, SUBTASK_STEPS[subtask - 1])


def posture(station, context) -> np.ndarray:
    """(8,) as measured."""
    return station.GetOutputPort("posture").Eval(context)


def hand_to_can(station, context):
    """Pose of the can to pick in the grasp frame."""
    plant_context = station.plant.GetMyContextFromRoot(context)
    X_WG = station.plant.GetFrameByName("grasp").CalcPoseInWorld(plant_context)
    can = station.plant.GetBodyByName("can", station.plant.GetModelInstanceByName(CANS[0]))
    return X_WG.inverse().multiply(station.plant.EvalBodyPoseInWorld(plant_context, can))


def picture(station, can_xy=(0.53, 0.0), vacant="left") -> np.ndarray:
    """(height, width, 3) what the camera sees of a scene, arm at home."""
    context = station.CreateDefaultContext()
    station.set_scene(context, np.array(can_xy), vacant)
    return station.GetOutputPort("rgb_image").Eval(context).data[:, :, :3].astype(int)


def red_pixels(image) -> np.ndarray:
    """(n, 2) rows and columns of the can to pick."""
    return np.argwhere((image[..., 0] > 90) & (image[..., 1] < 40) & (image[..., 2] < 40))
