"""What counts as success of the task, and what went wrong first, on hand-made rows."""

import numpy as np
import pytest

from diagrams.world.task import STALLED_TICKS, TaskMonitor, lasting_from, tilt

PLACE, NEIGHBOUR = np.array([0.2, 0.4, 0.1]), np.array([0.3, 0.3, 0.1])
HOME = np.array([0.5, 0.5, 0.0, 1.4, 0.0, 1.0, 0.0, 0.08])
CLOSED = np.append(HOME[:-1], 0.03)
MONITOR = TaskMonitor(PLACE, NEIGHBOUR, HOME)
STILL = np.tile(HOME, (6, 1))
DESK = PLACE - [0.0, 0.5, 0.05]


def poses(off=0.0, neighbour_off=0.0, tilt_deg=0.0, neighbour_tilt_deg=0.0, at=PLACE):
    def quaternion(degrees):
        half = np.deg2rad(degrees) / 2
        return [np.cos(half), np.sin(half), 0.0, 0.0]

    return np.concatenate(
        [quaternion(tilt_deg), at + [off, 0, 0], quaternion(neighbour_tilt_deg), NEIGHBOUR + [0, neighbour_off, 0]]
    )


@pytest.mark.parametrize(
    ("changes", "done"),
    [
        ({}, True),
        ({"off": 0.029}, True),
        ({"off": 0.031}, False),
        ({"tilt_deg": 14}, True),
        ({"tilt_deg": 16}, False),
        ({"tilt_deg": 180}, False),
        ({"neighbour_off": 0.019}, True),
        ({"neighbour_off": 0.021}, False),
        ({"neighbour_tilt_deg": 16}, False),
    ],
)
def test_cans(changes, done):
    assert MONITOR.success(poses(**changes), STILL, 0.08) is done


@pytest.mark.parametrize("joint", range(7))
def test_home_is_three_degrees_a_joint_for_half_a_second(joint):
    postures = STILL.copy()
    postures[:, joint] += np.deg2rad(2.9)
    assert MONITOR.success(poses(), postures, 0.08)
    postures[:, joint] += np.deg2rad(0.2)
    assert not MONITOR.success(poses(), postures, 0.08)
    postures[:, joint] = HOME[joint] + np.deg2rad([3.1, 2.95, 2.9, 2.85, 2.8, 2.75])  # not yet, half a second ago
    assert not MONITOR.success(poses(), postures, 0.08)
    postures[0, joint] = HOME[joint] + np.deg2rad(2.99)
    assert MONITOR.success(poses(), postures, 0.08)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize(("speed", "rests"), [(1.9, True), (2.1, False)])
def test_rest_is_slower_than_two_degrees_a_second(joint, speed, rests):
    postures = STILL.copy()
    postures[:, joint] += np.deg2rad(speed) * 0.1 * np.arange(6)
    assert MONITOR.at_rest(postures) is rests
    postures = STILL.copy()
    postures[3:, joint] += np.deg2rad(speed) * 0.1  # one tick of the last five
    assert MONITOR.at_rest(postures) is rests
    # Of a longer run the last half second counts; where the tick is half as long, ten of them.
    moving = np.vstack([STILL[:1], STILL[:1] + 1.0, STILL])
    assert MONITOR.at_rest(moving)
    assert not TaskMonitor(PLACE, NEIGHBOUR, HOME, 0.05).at_rest(moving)


def test_half_a_second_must_have_passed():
    assert MONITOR.at_rest(STILL)
    assert not MONITOR.at_rest(STILL[:5])


@pytest.mark.parametrize(("commanded", "gap", "done"), [(0.08, 0.076, True), (0.08, 0.074, False), (0.03, 0.08, False)])
def test_fingers_are_open_by_command_and_by_measure(commanded, gap, done):
    postures = STILL.copy()
    postures[:, -1] = commanded
    assert MONITOR.success(poses(), postures, gap) is done


def test_tilt_by_hand():
    half = np.deg2rad(30) / 2
    assert tilt(np.array([np.cos(half), 0, np.sin(half), 0, 0, 0, 0])) == pytest.approx(np.deg2rad(30))
    # About its axis; and a quaternion of length 2, a right angle; row by row.
    about, over = [2 * np.cos(half), 0, 0, 2 * np.sin(half), 0, 0, 0], [2**0.5, 2**0.5, 0, 0, 0, 0, 0]
    assert tilt(np.array([about, over])) == pytest.approx([0.0, np.pi / 2])


def test_lasting_from_by_hand():
    assert lasting_from(np.array([True, False, True, True])) == 2
    assert lasting_from(np.array([True, True])) == 0
    assert lasting_from(np.array([True, False])) is None


def run(*, closed, cans, moving=200):
    """200 rows: the arm moves until row `moving`, fingers closed in [a, b); cans[k] holds from row k on."""
    postures = np.tile(HOME, (200, 1))
    k = np.arange(200)
    postures[:, 0] += 0.01 * np.minimum(k, moving)
    for a, b in closed:
        postures[a:b, -1] = 0.03
    starts = sorted(cans)
    rows = np.array([cans[max(start for start in starts if start <= tick)] for tick in k])
    return MONITOR.failure(rows, postures)


IN_HAND = poses(at=PLACE + [0, 0, 0.2])
ON_DESK, TOPPLED = poses(at=DESK), poses(at=DESK, tilt_deg=90)
TAKEN = {0: ON_DESK, 40: IN_HAND}
GRASP = [(30, 120)]


@pytest.mark.parametrize(
    ("given", "kind", "when"),
    [
        ({"closed": [], "cans": {0: ON_DESK, 60: TOPPLED}}, "can toppled", 60),
        # The hand knocks it over, and closes on nothing; the other way round, it has missed the can first.
        ({"closed": [(70, 200)], "cans": {0: ON_DESK, 60: TOPPLED}}, "can toppled", 60),
        ({"closed": [(50, 200)], "cans": {0: ON_DESK, 60: TOPPLED}}, "missed grasp", 50),
        ({"closed": [(50, 200)], "cans": {0: ON_DESK}}, "missed grasp", 50),
        # Two grasps: the first one is made good by the second.
        ({"closed": [(20, 25), (30, 200)], "cans": TAKEN}, "time", 199),
        # The can is taken from the hand at 60; the second grasp misses it.
        ({"closed": [(30, 80), (90, 200)], "cans": TAKEN | {60: ON_DESK}}, "missed grasp", 90),
        ({"closed": GRASP, "cans": TAKEN | {120: poses(off=0.05)}}, "misplaced", 120),
        (
            {"closed": GRASP, "cans": TAKEN | {120: poses(off=0.05), 140: poses(off=0.05, tilt_deg=90)}},
            "misplaced",
            120,
        ),
        ({"closed": GRASP, "cans": TAKEN | {120: poses()}}, "time", 199),
        # The neighbour is pushed at 110, put back, and pushed again at 150.
        (
            {
                "closed": GRASP,
                "cans": TAKEN | {110: poses(neighbour_off=0.05), 130: poses(), 150: poses(neighbour_off=1)},
            },
            "neighbour moved",
            150,
        ),
        (
            {"closed": GRASP, "cans": TAKEN | {110: poses(at=IN_HAND[4:7], neighbour_off=0.05), 120: poses(1, 1)}},
            "neighbour moved",
            110,
        ),
        ({"closed": [], "cans": {0: ON_DESK}, "moving": 199 - STALLED_TICKS}, "stalled", 150),
        ({"closed": [], "cans": {0: ON_DESK}, "moving": 200 - STALLED_TICKS}, "time", 199),
        ({"closed": [], "cans": {0: ON_DESK, 60: TOPPLED}, "moving": 100}, "can toppled", 60),
        ({"closed": [], "cans": {0: ON_DESK, 160: TOPPLED}, "moving": 100}, "stalled", 101),
        (
            {"closed": [(30, 200)], "cans": TAKEN | {60: poses(at=IN_HAND[4:7], tilt_deg=30)}},
            "time",
            199,
        ),  # in the hand
    ],
)
def test_what_went_wrong_first(given, kind, when):
    assert run(**given) == (kind, when)
