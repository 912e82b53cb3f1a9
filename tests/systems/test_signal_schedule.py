"""SignalSchedule: what holds at which tick, also where t / T is a hair below k."""

import numpy as np
import pytest

from systems.signal_schedule import SignalSchedule

PERIOD = 0.1


def schedule(points):
    system = SignalSchedule(initial=[np.nan, 0.0], period=PERIOD)
    context = system.CreateDefaultContext()
    system.set_points(context, points)
    return system, context


def at(system, context, seconds):
    context.SetTime(seconds)
    return system.get_output_port().Eval(context).tolist()


def test_it_changes_at_the_tick_itself_and_not_before():
    system, context = schedule([(3, (1.0, 2.0)), (7, (3.0, 4.0))])
    assert np.isnan(at(system, context, 0.0)[0])
    assert np.isnan(at(system, context, 2.999 * PERIOD)[0])
    for k in range(3, 500):  # 0.1 k is not 10 k times 0.01: at many of these ticks t / T is not k
        expected = [1.0, 2.0] if k < 7 else [3.0, 4.0]
        assert at(system, context, k * PERIOD) == expected
        assert at(system, context, (k + 0.99) * PERIOD) == expected


def test_a_change_replaces_what_was_to_come_from_then_on():
    system, context = schedule([(3, (1.0, 2.0)), (7, (3.0, 4.0)), (9, (5.0, 6.0))])
    system.change(context, 7, [8.0, 8.0])
    assert system.points(context) == [(3, (1.0, 2.0)), (7, (8.0, 8.0))]
    assert at(system, context, 0.7) == [8.0, 8.0]  # also where it has been asked for before
    system.change(context, 7, [9.0, 9.0])
    assert at(system, context, 0.7) == [9.0, 9.0]


def test_a_clone_has_changes_of_its_own():
    system, context = schedule([(3, (1.0, 2.0))])
    clone = context.Clone()
    system.change(context, 4, [0.0, 0.0])
    assert system.points(clone) == [(3, (1.0, 2.0))]
    assert at(system, clone, 0.5) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("points", "named"),
    [
        ([(3, (1.0, 2.0)), (3, (1.0, 2.0))], "tick is 3.*at least 4"),
        ([(-1, (1.0, 2.0))], "tick is -1"),
        ([(1, (1.0,))], "values are .*2 numbers"),
        ([(1, (1.0, np.inf))], "values are .*infinite"),
    ],
)
def test_what_is_no_schedule_is_refused(points, named):
    with pytest.raises(ValueError, match=named):
        schedule(points)
