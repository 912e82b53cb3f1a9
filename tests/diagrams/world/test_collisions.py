"""Distances along a way: hand-worked heights over the desk, and the can that turns with the hand."""

import numpy as np
import pytest

from diagrams.world.collisions import CollisionChecker
from diagrams.world.names import CANS
from diagrams.world.station import arm_plant, can_body

PLACE = np.array([0.5, 0.0])  # the can to pick stands aside


def over_the_desk(hand, height):
    return hand.solve_ik(np.array([*PLACE, height]))


@pytest.mark.parametrize(
    ("held", "below"),
    # The finger tips are 17 mm below the grasp frame, the held can's feet 60; the hand leans by 5 deg.
    [(False, 0.017 + 0.013 * np.sin(np.deg2rad(5))), (True, 0.060 + 0.0224 * np.sin(np.deg2rad(5)))],
)
def test_height_over_the_desk(hand, held, below):
    checker = CollisionChecker(rigid_grasp=True)
    checker.set_scene(None if held else np.array([0.5, 0.3]), "left")
    high, low = over_the_desk(hand, below + 0.05), over_the_desk(hand, below + 0.004)
    assert checker.nearest_on(high[None]) == (0.01, None)
    distance, name = checker.nearest_on(np.array([high, low, high]))
    assert name == "desk"
    assert distance == pytest.approx(0.004, abs=0.001)
    assert checker.first_touch(low) == "desk"
    # What lies between two postures is looked at too.
    through = checker.nearest_on(np.array([high, 2 * low - high]))
    assert through[1] == "desk"
    assert through[0] < distance


def test_a_rigid_grasp_turns_the_can_with_the_hand(hand):
    """The can's middle is 10 mm farther out of the hand; without it, 10 mm below, however the hand leans."""
    joints = np.deg2rad([0.0, 40.0, 0.0, 90.0, 0.0, -40.0, 0.0])  # the hand points outwards
    arm = arm_plant()
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, np.append(joints, [0.0, 0.0]))
    X_WG = arm.GetFrameByName("grasp").CalcPoseInWorld(context)
    out_of_the_hand = X_WG.rotation().matrix()[:, 2]
    assert out_of_the_hand == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    for rigid, offset in ((True, [0.010, 0.0, 0.0]), (False, [0.0, 0.0, -0.010])):
        checker = CollisionChecker(rigid_grasp=rigid)
        checker.set_scene(None, "left")
        checker.first_touch(joints)
        pose = can_body(checker._plant, CANS[0]).EvalPoseInWorld(checker._plant_context)
        assert pose.translation() - X_WG.translation() == pytest.approx(offset, abs=1e-9)
