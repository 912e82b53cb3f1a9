"""What the arm touches: hand-worked heights over the desk, and the can that turns with the hand."""

import numpy as np
import pytest

from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import CANS
from diagrams.world.station import arm_plant, can_body

PLACE = np.array([0.5, 0.0])  # the can to pick stands aside


@pytest.mark.parametrize(
    ("held", "below"),
    # The finger tips are 17 mm below the grasp frame, the hand leans by 5 deg; the held can, upright, ends 60 below.
    [(False, 0.017 + 0.013 * np.sin(np.deg2rad(5))), (True, 0.060)],
)
def test_height_over_the_desk(hand, held, below):
    for gap in (0.01, 0.004):
        checker = CollisionChecker(World(), gap)
        checker.set_scene(None if held else np.array([0.5, 0.3]), "left")
        for above, touched in ((gap + 0.001, None), (gap - 0.001, "desk")):
            assert checker.first_touch(hand.solve_ik(np.array([*PLACE, below + above]))) == touched


def test_the_can_turns_with_the_hand(hand):
    joints = np.deg2rad([0.0, 40.0, 0.0, 90.0, 0.0, -40.0, 0.0])  # the hand points outwards
    arm = arm_plant(World())
    context = arm.CreateDefaultContext()
    arm.SetPositions(context, np.append(joints, [0.0, 0.0]))
    X_WG = arm.GetFrameByName("grasp").CalcPoseInWorld(context)
    out_of_the_hand = X_WG.rotation().matrix()[:, 2]
    assert out_of_the_hand == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)
    checker = CollisionChecker(World())
    checker.set_scene(None, "left")
    checker.first_touch(joints)
    pose = can_body(checker._plant, CANS[0]).EvalPoseInWorld(checker._plant_context)
    # 10 mm farther out of the hand, its axis along the hand's but for the 5 deg by which that leans at the grasp.
    offset = pose.translation() - X_WG.translation()
    assert np.linalg.norm(offset) == pytest.approx(0.010)
    assert offset @ out_of_the_hand == pytest.approx(0.010 * np.cos(np.deg2rad(5)))
    assert -pose.rotation().matrix()[:, 2] @ out_of_the_hand == pytest.approx(np.cos(np.deg2rad(5)))
