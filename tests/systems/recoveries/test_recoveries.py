"""Recoveries in the loop with an arm that follows exactly: what is led where, what ends it, what the network knows."""

import re
from pathlib import Path

import numpy as np
import pytest

import systems.recoveries
from systems.recoveries.registry import RECOVERIES, SHIPPED
from systems.recoveries.timed_recovery import TICKS
from tests.systems.controller_fakes import PERIOD, ClosedLoop, FakePolicy, TickArm, make_controller
from tests.systems.test_contract import wires_of
from tests.systems.test_law import Scheduled, pushed_before

DEAF = FakePolicy().horizon + 2
ONSET = 30  # tick of the alarm


class Loop:
    """The loop under an alarm at the ticks `alarms`; postures, hidden states and alpha by tick, after its update."""

    def __init__(self, name, alarms, ticks=120, push=None):
        policy = FakePolicy(drift=0.005)
        alphas = np.zeros(ticks + 1)
        alphas[list(alarms)] = 1.0
        recovery = RECOVERIES[name].build(policy, 3, PERIOD)
        controller = make_controller(policy=policy, detector=Scheduled(policy, *alphas), recovery=recovery)
        loop = ClosedLoop(controller, TickArm(policy.initial_posture), [None] * 3)
        rows = []
        for k in range(ticks):
            if push is not None and k == push:
                pushed_before(loop, k, [0.4, 0.0, 0.0, 0.0])
            loop.after_tick(k)
            rows.append([loop.output(n) for n in ("measured_posture", "hidden_state", "alpha", "recalled_postures")])
        self.posture, self.hidden, self.alpha, self.recalled = map(np.array, zip(*rows, strict=True))
        self.alpha, self.inputs = self.alpha[:, 0], np.array(policy.inputs)
        self.policy = policy


def test_what_ships_is_the_law_as_it_was():
    assert SHIPPED == "planned"
    for name, looks in (("planned", True), ("backoff", True), ("regulator", False)):
        assert (RECOVERIES[name].build(FakePolicy(), 3, PERIOD), RECOVERIES[name].looks) == (None, looks)


def test_one_alone_has_a_backoff():
    assert {name: RECOVERIES[name].backoff for name in RECOVERIES if hasattr(RECOVERIES[name], "backoff")} == {
        "backoff": 10.0
    }


def test_held_the_arm_stands_where_the_alarm_found_it_and_the_network_looks_on():
    loop = Loop("hold", [ONSET])
    acts = np.arange(120)
    assert np.array_equal(loop.alpha, (acts >= ONSET) & (acts < ONSET + TICKS))
    stood = loop.posture[ONSET : ONSET + TICKS + 1]
    assert np.abs(stood - stood[0]).max() < 1e-12
    scaled = loop.policy.scaling.scale(loop.posture)
    assert loop.inputs[:, :4] == pytest.approx(scaled)  # fed what is measured, at every tick
    step = np.diff(loop.posture[:, 0])
    assert step[ONSET + TICKS :] == pytest.approx(step[0])  # and it goes on


def test_held_the_arm_comes_back_to_where_it_stood():
    loop = Loop("hold", [ONSET], push=ONSET + 5)
    stood = loop.posture[ONSET, :3]
    assert loop.posture[ONSET + 5, 0] == pytest.approx(stood[0] + 0.4)
    assert loop.posture[ONSET + 6, :3] == pytest.approx(stood)


def test_an_alarm_that_stays_is_one_recovery_and_the_next_one_another():
    alarms = [*range(ONSET, ONSET + 50), *range(ONSET + 60, ONSET + 62)]
    found = np.flatnonzero(np.diff(Loop("hold", alarms).alpha) > 0) + 1
    assert found.tolist() == [ONSET, ONSET + 60]


def test_right_after_a_recovery_the_detector_is_not_heard():
    end = ONSET + TICKS
    heard = [k for k in range(end, end + DEAF + 3) if Loop("hold", [ONSET, k], end + DEAF + 5).alpha[k] == 1.0]
    assert heard[0] == end + DEAF


def test_retraced_arm_and_network_are_where_they_were():
    loop = Loop("retrace", [ONSET])
    for i in range(1, TICKS + 1):
        # In tick ONSET + i the arm is where it was i ticks before the alarm; the network remembers what it did then.
        assert loop.posture[ONSET + i, :3] == pytest.approx(loop.posture[ONSET - i, :3])
        assert np.array_equal(loop.hidden[ONSET + i - 1], loop.hidden[ONSET - i - 1])
        assert np.array_equal(loop.recalled[ONSET + i - 1], loop.recalled[ONSET - i - 1])
    after = slice(ONSET + TICKS, ONSET + TICKS + 60)
    before = slice(ONSET - TICKS, ONSET - TICKS + 20)
    assert loop.hidden[after][:20] == pytest.approx(loop.hidden[before])  # the same motion over again
    assert loop.posture[after][:20] == pytest.approx(loop.posture[before])
    step = np.diff(loop.posture[:, 0])
    assert step[ONSET + TICKS :] == pytest.approx(step[0])  # beyond where the alarm was too


def test_retraced_to_the_beginning_it_waits_there():
    loop = Loop("retrace", [5], 40)
    assert loop.posture[10 : 5 + TICKS + 1, :3] == pytest.approx(np.tile(loop.posture[0, :3], (TICKS - 4, 1)))


def test_a_network_that_was_put_back_is_not_stepped():
    """Nor is a picture taken for it: its last step before the alarm, then the first after the recovery."""
    loop = Loop("retrace", [ONSET], 60)
    assert len(loop.inputs) == 60 - TICKS


def test_what_a_recovery_adds_to_the_controller():
    policy = FakePolicy()
    plain = wires_of(make_controller(home_tolerance=0.1))
    recovery = RECOVERIES["hold"].build(policy, 3, PERIOD)
    wires = wires_of(make_controller(policy=policy, home_tolerance=0.1, recovery=recovery))
    assert {wire for wire in wires - plain if "alpha_mixer" not in wire and "unscaling" not in wire} == {
        "detector.alpha -> recovery.alarm",
        "posture_scaling.y0 -> recovery.posture",
        "recovery.acting -> alpha_hold.u",
        "recovery.acting -> home_reset.alpha",
        "loop_stays_closed.y0 -> loop_closer.alpha",
    }
    assert "recovery.recovery_step -> alpha_mixer.regulator_step" in wires


def test_the_list_of_the_package_is_that_of_its_files():
    listed = re.findall(r"^([a-z_]+) {2,}\S", systems.recoveries.__doc__, re.MULTILINE)
    assert sorted(listed) == sorted(p.stem for p in Path(systems.recoveries.__file__).parent.glob("[a-z]*.py"))
