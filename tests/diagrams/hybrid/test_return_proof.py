"""What ways home say about a promise: counts and bounds from ways made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.hybrid.return_loop import Trajectory
from diagrams.hybrid.return_promise import Promise
from diagrams.hybrid.return_proof import bound, holds, judge, of_draws, total
from diagrams.hybrid.return_samples import Sample

HOME = np.zeros(7)
AT_HOME = 0.01
PROMISE = Promise(0.0, 0.5, 0.5, False, 3)  # home after 7 ticks


def way(ticks, touches=None, slip=None, to=0.0, filtered=0):
    """A joint that is at home after so many ticks; V falls by half a tick."""
    values = np.append(0.5 ** np.arange(ticks), to)
    rows = np.outer(np.append(np.ones(ticks), to), np.ones(7))
    return Sample((1.0,) * 7, (0.5, 0.0), "left", slip is not None), Trajectory(
        rows, -0.002 if touches else 0.01, touches or "shelf", filtered, slip
    ), values  # fmt: skip


def report(*ways):
    return judge(*zip(*ways, strict=True), PROMISE, np.full(len(ways), 0.5), AT_HOME, HOME, 0.1)


def test_bounds_by_hand():
    assert bound(0, 10_000) == pytest.approx(1 - 0.05 ** (1 / 10_000))
    assert bound(0, 1) == pytest.approx(0.95)
    assert bound(0, 0) == 1.0
    assert bound(1, 1) == 1.0
    assert 0.3 < bound(1, 10) < 0.4  # Clopper-Pearson: 0.394


def test_more_failures_than_samples_are_an_error():
    with pytest.raises(ValueError, match="3 of 2 fail"):
        bound(3, 2)


def test_a_draw_that_fails_twice_is_counted_once():
    """Of four draws the first touches on both ways, the second has an onset outside, the last a target that fails."""
    fine, touching, lost = (one[1] for one in (way(3), way(3, "desk"), way(3, to=1.0)))
    onsets, targets = np.array([0.5, 1.2, 0.5, 0.5]), np.array([0.9, 0.9, 0.9, 1.0])
    assert of_draws([onsets, targets], [[touching, fine, fine], [touching, fine, fine, lost]], HOME) == (1, 2)


def test_ways_are_counted():
    found = report(
        way(6), way(7, slip=0.2), way(9, "desk"), way(3, "shelf", 0.01, to=1.0), way(8, filtered=2)
    )  # fmt: skip
    assert (found["all"]["samples"], found["all"]["failures"], found["all"]["later_than_certified"]) == (5, 1, 3)
    assert (found["free"]["samples"], found["free"]["failures"], found["free"]["later_than_certified"]) == (2, 0, 0)
    assert found["all"]["bounds"] == {
        "failures": bound(1, 5), "left_box": bound(0, 5), "later_than_certified": bound(3, 5), "touches": bound(2, 5),
        "failed_or_touched": bound(2, 5), "nearer": bound(2, 5),
    }  # fmt: skip
    assert found["all"]["failed_or_touched"] == 2  # one of them did both
    assert found["filtered"] == 1
    assert found["touches"] == {"desk": 1, "shelf": 1}
    assert (found["nearest_distance_m"], found["held"], found["dropped"], found["dropped_free"]) == (-0.002, 2, 1, 1)
    assert found["time_home_certified_s"] == pytest.approx(0.7)
    assert found["time_home_measured_s"] == {"median": pytest.approx(0.75), "max": pytest.approx(0.9)}
    sets = {"box": found, "onsets": report(way(5), way(9, "can_on_shelf"))}
    whole = total(sets)
    assert (whole["samples_inside"], whole["failures_inside"], whole["touches_inside"]) == (5, 1, 2)
    assert (whole["nearest_distance_m"], whole["bound_inside"]) == (-0.002, bound(1, 5))


@pytest.mark.parametrize(
    "broken",
    [
        {"later_than_certified": 1}, {"max_v_increase": 1e-4}, {"contraction_first_over": 0.01},
        {"contraction_rate_measured": 0.51},
    ],
)  # fmt: skip
def test_what_is_not_borne_out_does_not_hold(broken):
    found = report(way(6))
    assert holds({"sets": {"box": found}})
    assert not holds({"sets": {"box": found | {"free": found["free"] | broken}}})


@pytest.mark.parametrize("broken", [{"failures": 1}, {"left_box": 1}, {"touches": 1}])
def test_a_way_that_the_filter_changed_must_come_home_too(broken):
    found = report(way(6), way(12, filtered=3))  # in its own time
    assert holds({"sets": {"box": found}})
    assert not holds({"sets": {"box": found | {"all": found["all"] | broken}}})
    assert not holds({"sets": {"box": found | {"nearest_distance_m": 0.0049}}})


def test_each_way_is_judged_by_its_own_first_tick():
    """V of both is halved. Of one 0.5 is known, and 0.55 promised; of the other 0.44, and 0.49: it is not kept."""
    promise = Promise(0.05, 0.5, 0.7, False, 3)
    found = judge(*zip(way(6), way(6), strict=True), promise, np.array([0.5, 0.44]), AT_HOME, HOME, 0.1)
    assert (found["contraction_first"], found["free"]["contraction_first_measured"]) == (pytest.approx(0.75), 0.5)
    assert found["free"]["contraction_first_over"] == pytest.approx(0.01)
    assert found["time_home_certified_s"] == pytest.approx(0.8)
    assert not holds({"sets": {"onsets": found}})
    kept = judge(*zip(way(6), way(6), strict=True), promise, np.array([0.5, 0.45]), AT_HOME, HOME, 0.1)
    assert holds({"sets": {"onsets": kept}})


def test_the_arms_own_foot_is_something_too():
    sample, trajectory, values = way(6)
    for foot, touches, nearer in ((0.15, 0, 0), (0.004, 0, 1), (-0.001, 1, 1)):
        found = report((sample, replace(trajectory, foot=foot), values))
        assert (found["nearest_foot_m"], found["all"]["touches"], found["all"]["nearer"]) == (foot, touches, nearer)
        assert found["touches"] == ({"foot": 1} if touches else {})
        assert found["free"]["samples"] == 1 - touches
        assert holds({"sets": {"box": found}}) is (foot == 0.15)
    assert replace(trajectory, nearest=None, foot=-0.001).touches


def test_leaving_the_box_is_seen():
    sample, trajectory, _ = way(4)
    found = report((sample, trajectory, np.array([0.99, 1.01, 0.5, 0.2, 0.0])))
    assert found["all"]["left_box"] == 1
    assert found["all"]["max_v_increase"] == pytest.approx(0.02)
