"""Alarms and largest errors on a tape, by hand."""

import numpy as np
import pytest

from diagrams.monitors.metrics import largest_scores
from diagrams.monitors.scoring import Score, largest_before, peaks

RATIO = np.array([0.1, 2.0, 2.0, 0.5, 3.0, 1.0, 1.5, 4.0])


@pytest.mark.parametrize(
    ("gamma", "onset", "alarm", "false_alarms"),
    [
        (2.0, None, 1, 2),  # undisturbed: each is a false one (at the ticks 1 and 2, and at 4 and 7 below)
        (2.0, 3, 4, 1),
        (2.0, 5, 7, 2),
        (2.0, 2, 2, 1),  # under way at the onset
        (5.0, 3, None, 0),
        (3.0, 0, 4, 0),
    ],
)
def test_alarms_by_hand(gamma, onset, alarm, false_alarms):
    ratio = RATIO[:7] if onset is None else RATIO
    score = Score.of(ratio, gamma, onset)
    assert (score.alarm, score.false_alarms) == (alarm, false_alarms)


def test_peaks_say_the_largest_up_to_any_tick():
    found = peaks(RATIO)
    assert found == [(0, 0.1), (1, 2.0), (4, 3.0), (7, 4.0)]
    other = np.full(5, 0.0)
    for cut in range(1, 9):
        assert largest_before(found, cut) == RATIO[:cut].max()
    assert largest_before(found, 5) == largest_scores([RATIO, other])[0]
    assert peaks(np.zeros(4)) == [(0, 0.0)]
