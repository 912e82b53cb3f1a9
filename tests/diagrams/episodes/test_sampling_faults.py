"""Sampled faults: each makes a disturbance that a scenario could have given, within what its class promises."""

import numpy as np
import pytest

from diagrams.episodes.sampling import FROM_START, ON_SHELF, ONSET_LEVELS, STOP_TICKS
from diagrams.world.collisions import CollisionChecker
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS
from diagrams.world.names import CAN_RADIUS, other_spot
from diagrams.world.scenario import Scenario, load_scenario, save_scenario
from models.errors import InputError

SEEDS = range(6)


@pytest.mark.parametrize("kind", list(FAULTS))
def test_every_fault_is_sampled_as_it_says(kind, sampler, tmp_path):
    fault, subtasks = FAULTS[kind], set()
    for seed in SEEDS:
        episode = sampler.sample(seed, kind, severity=0.5)
        given, plain = episode.disturbance, sampler.sample(seed, "none")
        given.check()
        assert (episode.can_xy, episode.vacant) == (plain.can_xy, plain.vacant)
        assert (given.kind, given.severity, given.label) == (kind, 0.5, kind)
        least, most = ONSET_LEVELS[given.subtask]
        assert given.level == FROM_START if fault.from_start else least <= given.level <= most
        if fault.lasts:
            assert given.hold_ticks == 0
        elif not fault.targets:
            assert STOP_TICKS[0] <= given.hold_ticks <= STOP_TICKS[1]
        assert given == sampler.sample(seed, kind, severity=0.5).disturbance
        subtasks.add(given.subtask)
    assert subtasks == ({fault.subtask} if fault.subtask else {1, 2})
    # A scenario holds it, to the bit, and gives the same episode.
    path = tmp_path / "scenario.yaml"
    save_scenario(path, Scenario(seed=5, disturbance=given))
    loaded = load_scenario(path)
    loaded.check()
    assert loaded.disturbance == given
    assert sampler.episode(loaded).disturbance == given
    sampled = sampler.episode(Scenario(seed=5, disturbance=DisturbanceSpec(kind, severity=0.5)))
    assert sampled.disturbance == given


def test_a_can_is_moved_far_and_stays_in_reach(sampler):
    for seed in range(20):
        episode = sampler.sample(seed, "can_moved_far")
        sampler.require_reachable(episode.disturbance.can_moved_to)
        assert 0.10 <= np.hypot(*np.subtract(episode.disturbance.can_moved_to, episode.can_xy)) <= 0.14


def test_the_other_can_stays_on_the_shelf_and_off_the_vacant_spot(sampler, station):
    for seed in range(30):
        episode = sampler.sample(seed, "neighbour_moved")
        place, free = np.array(episode.disturbance.can_moved_to), station.spot(episode.vacant)[:2]
        stands = station.spot(other_spot(episode.vacant))[:2]
        assert 0.025 <= np.linalg.norm(place - stands) <= 0.035
        assert np.linalg.norm(place - free) >= np.linalg.norm(stands - free)
        along = (stands - free) / np.linalg.norm(stands - free)
        x, y = (place - (stands + free) / 2) @ np.array([[-along[1], along[0]], [along[0], along[1]]]).T
        assert abs(x) + CAN_RADIUS < 0.13 / 2
        assert abs(y) + CAN_RADIUS < 0.29 / 2


def test_the_arm_is_moved_again_and_again_to_where_it_may_be(sampler, world):
    checker = CollisionChecker(world)
    for kind in ("disturbed_return", "disturbed_resumption", "disturbed_thrice"):
        episode = sampler.sample(3, kind)
        given = episode.disturbance
        targets = np.array(given.target).reshape(FAULTS[kind].targets, 7)
        checker.set_scene(episode.can_xy if given.subtask == 1 else None, episode.vacant)
        assert all(checker.first_touch(target) is None for target in targets)
        assert len(np.unique(targets, axis=0)) == len(targets)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (DisturbanceSpec("camera_gone"), "no disturbance 'camera_gone': choose from none, A, B, moved, camera_gain"),
        (DisturbanceSpec("camera_shift", severity=1.5), "severity 1.5 is out of range: choose from 0 to 1"),
        (DisturbanceSpec("camera_shift", severity=float("nan")), "severity nan is out of range"),
        (DisturbanceSpec("A", severity=0.5), "severity 0.5 says nothing to the disturbance 'A'"),
        (DisturbanceSpec("camera_shift", hold_ticks=3), "level is missing"),
        (DisturbanceSpec("camera_shift", 0.1, hold_ticks=3), "hold_ticks 3 does not fit camera_shift: choose 0"),
        (DisturbanceSpec("camera_frozen", 0.1), "hold_ticks 0 does not fit camera_frozen: choose 1 or more"),
        (DisturbanceSpec("slack_gripper", 0.1, hold_ticks=9), "subtask 1 is not that of slack_gripper: choose 2"),
        (DisturbanceSpec("camera_shift", 0.1, target=[0.5] * 7), "give 0 joint angles"),
        (DisturbanceSpec("disturbed_thrice", 0.1, target=[0.5] * 7), "give 21 joint angles"),
        (DisturbanceSpec("can_moved", 0.1), "can_moved_to None does not fit can_moved: give the x and y"),
        (DisturbanceSpec("can_toppled", 0.1, can_moved_to=[0.5, 0.0]), "does not fit can_toppled: leave it out"),
        (DisturbanceSpec("can_moved", 0.1, can_moved_to=[0.5]), "is not two numbers"),
    ],
)
def test_what_makes_no_fault_is_named(given, named):
    with pytest.raises(InputError, match=named):
        given.check()


def test_places_that_no_can_may_be_put_are_named(sampler):
    far = DisturbanceSpec("neighbour_moved", 0.1, can_moved_to=[0.5, 0.0])
    with pytest.raises(InputError, match=rf"\[0.5, 0.0\] m is not on the shelf: choose a place within {ON_SHELF} m of"):
        sampler.episode(Scenario(vacant="left", disturbance=far))
    with pytest.raises(InputError, match="out of reach of what was taught"):
        sampler.episode(Scenario(disturbance=DisturbanceSpec("can_moved", 0.1, can_moved_to=[0.9, 0.0])))
    limits = DisturbanceSpec("disturbed_return", 0.1, target=[0.0] * 7 + [9.0] * 7)
    with pytest.raises(InputError, match="is outside of the joint limits"):
        sampler.episode(Scenario(disturbance=limits))
