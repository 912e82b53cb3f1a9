"""The way home in the loop: by the filter it touches nothing where the straight way does; scoring sees the truth."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.episodes.rollout import Rollout
from diagrams.episodes.way_home import WITHIN, WayHome
from diagrams.world.configuration import Clearance
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT


@pytest.fixture(scope="module")
def blocked(sampler):
    """Stopped with the can before the shelf, the neighbour beside the straight way home."""
    return next(e for e in (sampler.sample(s, "B") for s in range(200)) if touched_with_the_can(e))


def touched_with_the_can(episode):
    return episode.way_home_clear is False and episode.disturbance.can_moved_to is None


def run(world, encoder, policy, episode, cans):
    policy.learn(episode)
    return Rollout(replace(world, clearance=Clearance(cans=cans)), encoder, policy).run(episode)


@pytest.fixture(scope="module")
def runs(world, encoder, policy, blocked):
    return {cans: run(world, encoder, policy, blocked, cans) for cans in ("possible", "known", "unseen")}


def test_the_straight_way_touches_the_neighbour(runs):
    outcome, _ = runs["unseen"]
    assert outcome.way_home_m < 0.01
    assert outcome.way_home_nearest == "can_on_shelf"


@pytest.mark.parametrize("cans", ["possible", "known"])
def test_the_filtered_way_keeps_its_distance(runs, cans):
    outcome, _ = runs[cans]
    assert outcome.success
    assert outcome.switch_success
    assert outcome.way_home_m > 0.008


def test_before_the_way_home_the_filter_changes_no_bit(runs):
    filtered, straight = runs["possible"][1], runs["unseen"][1]
    first = int(np.argmax(filtered.alpha >= 0.5))
    assert 0 < first < len(straight.time)
    for name in ("posture", "desired_posture", "hidden_state"):
        assert np.array_equal(getattr(filtered, name)[:first], getattr(straight, name)[:first])


def test_the_filter_has_no_state(world, encoder, policy):
    rollout = Rollout(world, encoder, policy)
    system = rollout.diagram.GetSubsystemByName("clearance_filter")
    assert system.CreateDefaultContext().num_total_states() == 0


def test_what_the_truth_says_is_that_of_the_tick(world, encoder, policy):
    """The cans move between the ticks; what the arm is to follow does not."""
    rollout = Rollout(replace(world, clearance=Clearance(cans="known")), encoder, policy)
    wires = {
        (target.get_name(), source.get_name()) for (target, _), (source, _) in rollout.diagram.connection_map().items()
    }
    assert ("clearance_filter", "obstacles_hold") in wires
    assert ("clearance_filter", "station") not in wires


def test_distances_of_scoring_by_hand(station, hand):
    context = station.CreateDefaultContext()
    station.set_scene(context, np.array([0.53, 0.0]), "left")
    plant = station.plant
    own = plant.GetMyMutableContextFromRoot(context)

    def see(joints, opening, closed):
        plant.SetPositions(own, station.arm, joints)
        plant.SetPositions(own, station.gripper, [opening / 2, opening / 2])
        way = WayHome(station)
        way.see(context, closed)
        return way.nearest, way.name

    can, neighbour = np.array([0.53, 0.0, CAN_HALF_HEIGHT]), station.spot("right")
    # Around the can that it is about to grasp, nothing counts but the desk, which the fingers end 33 mm above.
    grasping = hand.solve_ik(can + [0, 0, 0.0])
    assert see(grasping, 0.08, closed=False) == (pytest.approx(0.033, abs=0.003), "desk")
    # Fingertips 4 cm above the neighbour.
    above = hand.solve_ik(neighbour + [0, 0, CAN_HALF_HEIGHT + 0.04 + 0.017])
    assert see(above, 0.053, closed=True) == (pytest.approx(0.04, abs=0.004), "can_on_shelf")
    # The held can stands on the desk: it touches it; where the fingers are open it is not held.
    assert see(grasping, 0.053, closed=True) == (pytest.approx(0.0, abs=1e-3), "desk")
    # 35 mm up between the fingers, which touch it: still held.
    slid = hand.solve_ik(can + [0, 0, 0.035])
    assert see(slid, 0.046, closed=True) == (pytest.approx(0.0, abs=1e-3), "desk")
    assert see(slid, 0.046, closed=False)[1] == "can_to_pick"
    far = hand.solve_ik(can + [0, 0, 0.25])
    assert see(far, 0.08, closed=False) == (WITHIN, None)
    assert len(far) == ARM_JOINTS
