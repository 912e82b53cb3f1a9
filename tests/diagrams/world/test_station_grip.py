"""The grip of the station's fingers: a can is lifted, and does not slip in the hand."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagrams.world.names import CAN_HALF_HEIGHT
from diagrams.world.station import PickPlaceStation
from tests.diagrams.world.station_runs import hand_to_can, play, posture, start, taught


@pytest.fixture(scope="module")
def lifted(world, hand):
    """A station without camera, and a simulator after subtask 1: the can is in the hand, the arm at home."""
    station = PickPlaceStation(world, camera=False)
    simulator = start(station)
    play(station, simulator, taught(station, hand, (0.53, 0.0), "left", 1))
    return station, simulator


def rerun(lifted):
    """A simulator that goes on from a copy of the Context of `lifted`."""
    station, simulator = lifted
    copy = Simulator(station, simulator.get_context().Clone())
    copy.Initialize()
    return station, copy


def test_can_is_lifted_and_the_loaded_arm_is_still_at_home(lifted, world):
    station, simulator = lifted
    context = simulator.get_context()
    can = station.GetOutputPort("can_poses").Eval(context)
    assert can[6] - CAN_HALF_HEIGHT > 0.1
    assert np.abs(posture(station, context) - world.initial_posture)[:7].max() < np.deg2rad(0.1)
    fingers = station.plant.GetPositions(station.plant.GetMyContextFromRoot(context), station.gripper)
    # Pads of radius 4 mm, their centres 11 mm beside the middle and 4 mm inside, stall on a can of radius 26.5 mm ...
    assert fingers.sum() == pytest.approx(2 * (np.sqrt(0.0305**2 - 0.011**2) - 0.004), abs=0.003)
    assert fingers[0] == pytest.approx(fingers[1], abs=1e-4)  # ... which stays in the middle


def test_held_can_does_not_slip(lifted, hand, world):
    station, simulator = rerun(lifted)
    first = hand_to_can(station, simulator.get_context())
    moved = []

    def compare(context):
        change = first.inverse().multiply(hand_to_can(station, context))
        moved.append((np.linalg.norm(change.translation()), change.rotation().ToAngleAxis().angle()))

    held = np.append(world.initial_posture[:-1], world.closed_opening)
    play(station, simulator, [held] * 50, compare)
    # The path to the shelf, as far as the fingers stay closed.
    path = taught(station, hand, (0.53, 0.0), "left", 2)
    play(station, simulator, path[path[:, -1] < 0.04], compare)
    # In 17 s; what there is, is the slow creep of a regularized friction.
    distance, angle = np.max(moved, axis=0)
    assert distance < 0.001
    assert angle < np.deg2rad(2.0)
