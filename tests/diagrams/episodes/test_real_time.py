"""Real time, with a clock that is told; and its words, by hand."""

import numpy as np
import pytest

from diagrams.episodes import real_time
from diagrams.episodes.real_time import RealTime, tick_words


class Clock:
    """`work` seconds pass by themselves, those that are slept too."""

    def __init__(self):
        self.now, self.slept = 100.0, []

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds

    def work(self, seconds):
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(real_time, "time", clock)
    return clock


def slept(clock, rate, works):
    waiting = RealTime(0.1, rate)
    for ticks, work in enumerate(works, 1):
        clock.work(work)
        waiting.wait(ticks)
    return clock.slept


@pytest.mark.parametrize(
    ("rate", "works", "waits"),
    [
        (1.0, [0.5, 0.03, 0.03], [0.1, 0.07, 0.07]),  # the first tick begins the count
        (2.0, [0.5, 0.03, 0.03], [0.05, 0.02, 0.02]),
        (1.0, [0.5, 0.15, 0.03], [0.1, 0.0, 0.02]),  # what was late is made up for
        (0.0, [0.5, 0.03, 0.03], [0.0, 0.0, 0.0]),
    ],
)
def test_waits_by_hand(clock, rate, works, waits):
    assert slept(clock, rate, works) == pytest.approx(waits)


def test_words_by_hand():
    seconds = np.array([0.01] * 50 + [0.02] * 49 + [0.25, 0.1])
    assert tick_words(seconds, 0.1) == (
        "1 of 101 ticks late (over 100 ms); a tick takes 20.0 ms in the median, 100.0 ms at 99 %, 250.0 ms at most"
    )
