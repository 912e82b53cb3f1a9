"""Perturbations: proposals by hand, and what is made of their outcome."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.sampling import ONSET_LEVELS
from diagrams.episodes.switching import DEFEATS
from diagrams.hybrid.perturbations import (
    REQUIRED,
    NominalRun,
    Perturbation,
    PerturbationSpace,
    judge,
    least_robustness,
)
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.requirements import SIGNALS, requirements
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


def run_record(worst, home):
    """Five ticks undisturbed, three stopped, then on; `worst`: the largest error a tick; `home`: from which on."""
    worst, ticks = np.asarray(worst, float), np.arange(len(worst))
    alpha = (worst > GAMMA).astype(float)
    values = {"alpha": alpha, "active": (ticks >= 5) & (ticks < 8), "home": ticks >= home}
    signals = np.column_stack([np.broadcast_to(np.asarray(values.get(n, 0.0), float), len(ticks)) for n in SIGNALS])
    return SimpleNamespace(errors=np.tile(worst[:, None], 11), signals=signals)


FAR = [0.1] * 5 + [1000.0] * 7 + [0.1] * 5


@pytest.mark.parametrize(
    ("switch_failure", "success", "worst", "failure", "objective"),
    [
        ("not returned", False, FAR, "not returned", DEFLECTED.magnitude),
        ("not detected", False, FAR, "not detected", DEFLECTED.magnitude),
        # The network coped with it: the error rose to a tenth of the threshold, to the threshold but for a hair.
        ("not detected", True, [1.0] * 17, None, 2.0),
        (
            "not detected",
            True,
            [1.0] * 6 + [9.999] * 11,
            None,
            1.9 - np.log10(0.9999),
        ),  # alpha is 0, and 0.9 is asked for
        # Two decades above, two below: as far as counts.
        (None, True, FAR, None, 2.0),
        # Noticed with the error at 1.25 times the threshold: alpha is 1, log10(1.25) more, and 0.9 is asked for.
        (None, True, [0.1] * 5 + [12.5] * 3 + [1000.0] * 4 + [0.1] * 5, None, 1.1 + np.log10(1.25)),
        # On the way home the error came down to 1.1 times the threshold: 1/2 is asked for.
        (None, True, [0.1] * 5 + [1000.0] * 3 + [11.0] + [1000.0] * 3 + [0.1] * 5, None, 1.5 + np.log10(1.1)),
        # At home it came down to half of it: at most 0.1 is asked for.
        (None, True, [0.1] * 5 + [1000.0] * 7 + [5.0] * 5, None, 1.1 + np.log10(2.0)),
        # Later it rose to four fifths of it.
        (None, True, [0.1] * 5 + [1000.0] * 7 + [0.1] * 4 + [8.0], None, 1.5 + np.log10(1.25)),
    ],
)
def test_judgement(switch_failure, success, worst, failure, objective):
    outcome, record = replace(OUTCOME, switch_failure=switch_failure, success=success), run_record(worst, home=10)
    assert judge(DEFLECTED, outcome, record, 0.1, GAMMA) == (failure, pytest.approx(objective))
    if not success:
        return
    assert (least_robustness(record, 0.1, GAMMA) < 0.0) is (switch_failure is not None)


def test_what_a_defeat_breaks_is_required():
    assert set(REQUIRED) < set(requirements(0.1))
    assert len(REQUIRED) == len(DEFEATS)
