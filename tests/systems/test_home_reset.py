"""HomeReset: by hand, and what it does in the loop."""

import numpy as np
import pytest

from systems.home_reset import HomeReset
from tests.systems.controller_fakes import ClosedLoop, FakePolicy, TickArm, make_controller
from tests.systems.test_law import Scheduled

HOME, TOLERANCE = np.array([0.5, -0.5]), np.array([0.1, 0.2])


@pytest.mark.parametrize(
    ("posture", "alpha", "expected"),
    [
        ([0.5, -0.5, 9.0], 1.0, 1.0),  # the fingers have no say
        ([0.59, -0.69, 0.0], 0.5, 1.0),
        ([0.59, -0.69, 0.0], 0.49, 0.0),  # the network has the arm
        ([0.61, -0.5, 0.0], 1.0, 0.0),
        ([0.5, -0.29, 0.0], 1.0, 0.0),
    ],
)
def test_by_hand(posture, alpha, expected):
    system = HomeReset(posture_size=3, initial_posture=HOME, tolerance=TOLERANCE)
    context = system.CreateDefaultContext()
    system.GetInputPort("posture").FixValue(context, posture)
    system.GetInputPort("alpha").FixValue(context, [alpha])
    assert system.get_output_port().Eval(context)[0] == expected


def test_more_joints_than_the_posture_has_are_refused():
    with pytest.raises(ValueError, match=r"joints is 2.*at most 1"):
        HomeReset(posture_size=1, initial_posture=HOME, tolerance=TOLERANCE)


def test_in_the_loop_the_network_is_kept_in_its_initial_state_while_the_arm_is_at_home():
    """alpha is 1 at ticks 0 to 3; a joint that is off by 0.12 is at 0.108 at tick 1, within 0.1 from tick 2 on."""
    policy = FakePolicy()
    controller = make_controller(policy=policy, detector=Scheduled(policy, *[1.0] * 4), home_tolerance=0.1)
    arm = TickArm(policy.initial_posture + np.array([0.12, 0.0, 0.0, 0.0]))
    loop = ClosedLoop(controller, arm, [None] * 3)
    steps, home = [], policy.scaling.scale(policy.initial_posture)
    for k in range(6):
        loop.after_tick(k)
        steps.append(len(policy.inputs))
    assert steps == [1, 2, 2, 2, 3, 4]
    assert policy.inputs[-2][:4] == pytest.approx(home, abs=0.1)


@pytest.mark.parametrize("tolerance", [None, 0.1])
def test_while_the_network_has_the_arm_nothing_changes(tolerance):
    policy = FakePolicy(drift=0.02)
    controller = make_controller(policy=policy, detector=Scheduled(policy), home_tolerance=tolerance)
    loop = ClosedLoop(controller, TickArm(policy.initial_posture), [None] * 3)
    for k in range(4):
        loop.after_tick(k)
    assert len(policy.inputs) == 4
    assert loop.posture()[0] == pytest.approx(
        policy.initial_posture[0] + 0.02 * 4 * policy.scaling.half_range[0], abs=0.1
    )
