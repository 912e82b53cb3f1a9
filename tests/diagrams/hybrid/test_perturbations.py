"""Perturbations: proposals by hand, and what is made of their outcome."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.sampling import ONSET_LEVELS
from diagrams.hybrid.perturbations import NominalRun, Perturbation, PerturbationSpace, judge
from diagrams.world.disturbance import DisturbanceSpec
from tests.diagrams.episode_fakes import OUTCOME

SCENES = [Episode(5, (0.555, -0.041), "left"), Episode(6, (0.5, 0.02), "right")]
DEFLECTED = Perturbation(0, DisturbanceSpec("A", 0.15, [0.0] * 7, 5), 30.0)
GAMMA = 10.0


@pytest.fixture(scope="module")
def space(world):
    """At home all the time, and far from the goals but for one tick of scene 0 and one of scene 1."""
    space = PerturbationSpace(world, [], [])
    space._scenes = SCENES
    at_home = np.tile(world.initial_posture[:7], (3, 1))
    goes = np.array([1.0, 1.0, 0.0])
    space.runs = [NominalRun({1: goes, 2: goes}, at_home), NominalRun({1: np.ones(3), 2: goes}, at_home)]
    return space


def propose(space, **given):
    middle = {"form": 0.1, "size_deg": 10.0, "moment": 0.25, "hold_ticks": 3.4, "scene": 0.1, "place_x": 0.0,
              "direction_1": 0.3, "direction_4": 0.4} | {f"direction_{j}": 0.0 for j in (2, 3, 5, 6, 7)}  # fmt: skip
    return space.propose(lambda name, low, high: (middle | given).get(name, 0.5))


def test_a_deflection_by_hand(space, world):
    found = propose(space)
    disturbance = found.disturbance
    assert (found.scene, found.form, found.size_deg, found.ticks) == (0, "deflected", 10.0, 8 + 3)
    assert (disturbance.kind, disturbance.subtask, disturbance.can_moved_to) == ("A", 1, None)
    assert disturbance.level == pytest.approx(0.5 * sum(ONSET_LEVELS[1]))
    off = np.rad2deg(np.array(disturbance.target) - world.initial_posture[:7])
    assert off == pytest.approx([6.0, 0, 0, 8.0, 0, 0, 0])
    assert found.magnitude == pytest.approx(0.5 * 10 / 60 + 0.5 * 11 / 33)
    nothing = propose(space, direction_1=0.0, direction_4=0.0)
    assert nothing.disturbance.target == world.initial_posture[:7].tolist()
    disturbance.check()


def test_moments_go_from_the_earliest_to_the_latest(space):
    for moment, subtask, end in ((0.0, 1, 1), (0.4999, 1, 0), (0.5, 2, 1), (0.9999, 2, 0)):
        disturbance = propose(space, moment=moment).disturbance
        assert disturbance.subtask == subtask
        assert disturbance.level == pytest.approx(ONSET_LEVELS[subtask][end], abs=1e-4)


def test_a_stop_by_hand(space):
    found = propose(space, form=0.5)
    assert found == Perturbation(0, DisturbanceSpec("B", found.disturbance.level, None, 3, 1), 0.0)
    assert (found.form, found.magnitude) == ("stopped", pytest.approx(0.5 * 3 / 33))
    assert propose(space, form=0.5, hold_ticks=0.0).ticks == 1  # no time at all is no stop


def test_a_taken_can_is_put_on_the_grid(space, world, sampler):
    lower, upper = world.grid.bounds
    for place, xy in (((0.0, 0.0), lower), ((1.0, 1.0), upper), ((0.5, 0.5), 0.5 * (lower + upper))):
        found = propose(space, form=0.9, moment=0.75, place_x=place[0], place_y=place[1])
        assert (found.form, found.ticks, found.size_deg) == ("taken", 5, 0.0)  # 3 ticks are too short for it
        assert found.disturbance.can_moved_to == pytest.approx(list(xy))
        sampler.require_reachable(found.disturbance.can_moved_to)
        found.disturbance.check()
    assert propose(space, form=0.9).form == "stopped"  # before subtask 2 nothing is in the hand


def test_what_no_experimenter_could_do_is_none(space, monkeypatch):
    assert propose(space, scene=0.9999) is None  # the moment does not come
    assert propose(space, scene=0.9999, moment=0.75).scene == 1
    assert propose(space, size_deg=60.0) is None  # joint 4 has 22 deg to its limit
    assert propose(space, form=0.5, size_deg=60.0) is not None
    monkeypatch.setattr(space._checker, "path_touches", lambda start, goal: "desk")
    assert propose(space) is None


def test_a_way_home_that_touches_something_is_no_reason_against_it(space, world, monkeypatch):
    home = world.initial_posture[:7]
    monkeypatch.setattr(
        space._checker, "path_touches", lambda start, goal: "desk" if np.array_equal(goal, home) else None
    )
    assert propose(space) is not None


def test_nominal_commands_by_hand(world, hand):
    n = 4
    joints = np.array([world.initial_posture + 0.1 * k for k in range(n)])
    goal = hand.grasp_position(joints[3, :7])
    cans = np.tile(np.concatenate(([1, 0, 0, 0], goal, np.zeros(7))), (n, 1))
    record = SimpleNamespace(can_poses=cans, posture=joints, desired_posture=joints + 0.01)
    nominal = NominalRun.of(record, hand, goal + [0, 0, 1.0])
    between = 0.5 * (nominal.distances[1][1] + nominal.distances[1][2])
    assert nominal.command_at(1, between) == pytest.approx(joints[1, :7] + 0.01)
    assert nominal.command_at(2, 0.5) is None


def run_record(worst):
    """Five ticks undisturbed, three stopped, then on; `worst`: the largest error at each of twelve ticks."""
    errors = np.tile(np.asarray(worst, float)[:, None], 11)
    alpha = (np.asarray(worst) > GAMMA).astype(float)
    active = np.array([False] * 5 + [True] * 3 + [False] * 4)
    return SimpleNamespace(errors=errors, alpha=alpha, active=active)


UNSEEN = replace(OUTCOME, detection_delay_s=None, return_s=None, resume_s=None)
FAR = [0.1] * 5 + [1000.0] * 7


@pytest.mark.parametrize(
    ("change", "worst", "failure", "objective"),
    [
        ({"switch_failure": "not returned", "success": False}, FAR, "not returned", DEFLECTED.magnitude),
        ({"switch_failure": "not detected", "success": False}, FAR, "not detected", DEFLECTED.magnitude),
        # The network coped with it: the error rose to a hundredth, then to a tenth of the threshold, of two decades.
        ({"switch_failure": "not detected"}, [0.1] * 12, None, 2.0),
        ({"switch_failure": "not detected"}, [0.1] * 6 + [1.0] * 6, None, 1.5),
        # Noticed after 0.2 of (8 + 5) * 0.1 s; resumed after 1 of 6 s.
        ({"detection_delay_s": 0.2, "resume_s": 1.0}, FAR, None, 1 + 5 / 6),
        ({"detection_delay_s": 0.975, "resume_s": 1.0}, FAR, None, 1.25),
        # Home two ticks after the end, at tick 10, with the error down to twice the threshold at tick 9.
        ({"detection_delay_s": 0.2, "resume_s": 1.0, "return_s": 0.2}, [*FAR[:9], 20.0, 1e3, 1e3], None,
         1 + np.log10(2) / 2),
    ],
)  # fmt: skip
def test_judgement(change, worst, failure, objective):
    found = judge(DEFLECTED, replace(UNSEEN, **change), run_record(worst), 0.1, GAMMA)
    assert found == (failure, pytest.approx(objective))
