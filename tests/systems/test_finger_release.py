"""FingerRelease: by hand, and what it does in the loop."""

import numpy as np
import pytest
from pydrake.systems.primitives import ConstantVectorSource

from systems.finger_release import FingerRelease
from tests.systems.controller_fakes import ClosedLoop, FakePolicy, TickArm, make_controller
from tests.systems.test_law import Scheduled

EMPTY, HOLDING = 0.030, 0.046  # measured gaps, m: of closed fingers, and with the can between them


def released(command, reset, gaps):
    system = FingerRelease(posture_size=4, joints=2, opening=[0.08, 0.06], empty_below=[0.035, 0.035])
    context = system.CreateDefaultContext()
    for name, value in (("desired_posture", command), ("reset", [reset]), ("finger_gaps", gaps)):
        system.GetInputPort(name).FixValue(context, value)
    return system.get_output_port().Eval(context).tolist()


@pytest.mark.parametrize(
    ("reset", "gaps", "fingers"),
    [
        (1.0, [EMPTY, EMPTY], [0.08, 0.06]),
        (1.0, [EMPTY, HOLDING], [0.08, 0.03]),  # each by its own gap
        (1.0, [0.035, HOLDING], [0.03, 0.03]),  # at the limit it may hold something
        (0.0, [EMPTY, EMPTY], [0.03, 0.03]),  # not at home, or the network has the arm
    ],
)
def test_by_hand(reset, gaps, fingers):
    assert released([0.4, -0.2, 0.03, 0.03], reset, gaps) == [0.4, -0.2, *fingers]


def test_open_fingers_stay_open_whatever_is_measured():
    assert released([0.0, 0.0, 0.08, 0.06], 1.0, [EMPTY, EMPTY]) == [0.0, 0.0, 0.08, 0.06]


def test_a_limit_above_the_open_fingers_is_refused():
    with pytest.raises(ValueError, match=r"empty_below is \[0.09\] and opening is \[0.08\].*must be less"):
        FingerRelease(posture_size=3, joints=2, opening=[0.08], empty_below=[0.09])


def test_a_limit_without_a_new_start_is_refused():
    with pytest.raises(ValueError, match=r"empty_below is 0.5 without a home_tolerance: give both, or none"):
        make_controller(empty_below=0.5)


@pytest.mark.parametrize(("gap", "opens"), [(-1.0, True), (-0.2, False)])
def test_in_the_loop_closed_fingers_open_from_the_first_tick_at_home_on(gap, opens):
    """alpha is 1 at ticks 0 to 3; a joint that is off by 0.12 is at 0.108 at tick 1, within 0.1 from tick 2 on."""
    policy = FakePolicy()
    controller = make_controller(
        policy=policy, detector=Scheduled(policy, *[1.0] * 4), home_tolerance=0.1, empty_below=-0.5
    )
    start = policy.initial_posture + np.array([0.12, 0.0, 0.0, 0.0])
    start[-1] = -1.0  # commanded closed
    loop = ClosedLoop(controller, TickArm(start), [None] * 3, finger_gaps=ConstantVectorSource([gap]))
    fingers = []
    for k in range(4):
        loop.after_tick(k)
        fingers.append(loop.output("desired_posture")[-1])
    assert fingers == pytest.approx([-1.0, -1.0, 1.0, 1.0] if opens else [-1.0] * 4)
