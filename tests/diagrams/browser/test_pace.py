"""Pace: when a tick is due, when it is late, and the words at the end, by a clock made by hand."""

import pytest

from diagrams.browser.pace import RECENT, Pace


def run(pace, lengths, now=100.0):
    """Ticks of these lengths (s), each begun as soon as it is due; when each began."""
    began = []
    for length in lengths:
        now += pace.wait(now)
        began.append(now)
        pace.ran(now, now := now + length)
    return began


def test_ticks_that_are_short_enough_begin_on_the_beat():
    assert run(Pace(0.1), [0.03, 0.09, 0.01, 0.0]) == pytest.approx([100.0, 100.1, 100.2, 100.3])


def test_a_slow_tick_is_late_and_made_up_for_where_that_is_possible():
    pace = Pace(0.1)
    # The second ends 0.05 s after the third is due; the third is short: back on the beat.
    assert run(pace, [0.05, 0.15, 0.02, 0.02]) == pytest.approx([100.0, 100.1, 100.25, 100.3])
    assert (pace.ticks, pace.late) == (4, 1)


def test_what_is_far_behind_is_not_hurried_after():
    pace = Pace(0.1)
    assert run(pace, [1.0, 0.05, 0.05]) == pytest.approx([100.0, 101.0, 101.1])
    assert pace.late == 1


def test_speeds():
    assert run(Pace(0.1, 0.25), [0.05] * 3) == pytest.approx([100.0, 100.4, 100.8])
    assert run(Pace(0.1, 5.0), [0.01] * 3) == pytest.approx([100.0, 100.02, 100.04])
    fastest = Pace(0.1, 0.0)
    assert run(fastest, [0.3, 0.01]) == pytest.approx([100.0, 100.3])
    assert fastest.late == 0


def test_a_rest_is_no_delay():
    pace = Pace(0.1)
    run(pace, [0.05], 100.0)
    pace.rest()
    assert run(pace, [0.05, 0.05], 200.0) == pytest.approx([200.0, 200.1])
    assert pace.late == 0


def test_share_of_the_last_ticks_and_words():
    pace = Pace(0.1)
    assert pace.words() == "no tick was run"
    run(pace, [0.25, 0.02] * (RECENT // 4) + [0.02] * (RECENT // 2))
    assert 0.2 < pace.behind() < 0.6
    run(pace, [0.02] * RECENT, 1000.0)
    pace.rest()
    assert pace.behind() <= 0.01
    assert pace.lengths.quantile(0.5) == pytest.approx(0.02, abs=0.001)
    assert pace.lengths.quantile(0.999) == pytest.approx(0.25, abs=0.001)
    assert "a tick takes 20.0 ms in the median, 250" in pace.words()


def test_behind_is_a_share_of_the_ticks_at_this_speed():
    pace = Pace(0.1, 5.0)
    for k in range(4):
        pace.ran(0.1 * k, 0.1 * k + 0.09)  # 20 ms are allowed
    assert pace.behind() == 1.0
    pace.set_speed(1.0)
    assert pace.behind() == 0.0
    pace.ran(1.0, 1.3)
    assert pace.behind() == 1.0
