"""AlarmBackoff: by hand, tick by tick; its laws; and what it does in the loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from systems.alarm_backoff import MOST, PATIENCE, AlarmBackoff
from systems.detector import GUARD, alpha_of
from systems.dialled_detector import DialledDetector
from systems.never_detector import NeverDetector
from systems.oracle_detector import OracleDetector
from systems.recoveries.registry import RECOVERIES
from tests.systems.controller_fakes import PERIOD, ClosedLoop, FakePolicy, TickArm, make_controller
from tests.systems.outside_detector import FarFromHome
from tests.systems.system_checks import fix
from tests.systems.test_contract import wires_of

BETA, GAMMA, FACTOR = 30.0, 2.0, 10.0
TICKS = round(PATIENCE / PERIOD)


def run(errors, alphas=None, factor=FACTOR):
    """alpha as it is answered, and whether the return is given up, at each tick; of a detector with one criterion.

    `alphas`: the detector's own, else by Eqs. 5 and 6.
    """
    system = AlarmBackoff(criteria=1, factor=factor, period=PERIOD)
    context, rows = system.CreateDefaultContext(), []
    system.set_calibration(context, BETA, GAMMA)
    for k, error in enumerate(errors):
        alpha = alpha_of(np.array([error]), BETA, GAMMA) if alphas is None else alphas[k]
        fix(system, context, dict(alpha=[alpha], errors=[error]))
        rows.append([system.GetOutputPort(name).Eval(context)[0] for name in ("answered_alpha", "given_up")])
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    return np.array(rows).T


def answered(errors, alphas=None, factor=FACTOR):
    return run(errors, alphas, factor)[0]


def told(errors):
    """0 or 1 at each tick: whether alpha is high as it is answered, and whether the return is given up."""
    return (run(errors) >= GUARD).astype(int).tolist()


def test_each_answer_asks_for_ten_times_the_error():
    """By hand: gamma is 2, then 20, then 200; an error between is an alarm by the first alone."""
    errors = [0, 3, 3, 0, 3, 19, 21, 21, 0, 21, 199, 201, 0, 199, 201, 0]
    high = answered(errors) >= GUARD
    assert high.tolist() == [0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 1, 0]  # from the second on, alike


def test_a_return_is_given_up_where_the_error_is_below_the_raised_gamma():
    """One tick more, in which the network starts anew: what it recalls then says whether the arm is near home."""
    near = told([3, 0, 21, 21, 3, 3, 3, 0])
    assert near == [[1, 0, 1, 1, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0, 0, 0]]
    away = told([3, 0, 21, 3, 25, 30, 0])
    assert away == [[1, 0, 1, 1, 1, 1, 0], [0, 0, 0, 1, 0, 0, 0]]


def test_a_return_that_ends_by_the_detectors_own_alpha_is_not_given_up():
    assert told([3, 3, 0, 21, 0]) == [[1, 1, 0, 1, 0], [0] * 5]


def test_the_first_alarm_is_the_detectors_to_the_bit():
    errors = [0.3, 1.99, 2.001, 2.02, 7.0, 2.0]
    alphas = [0.1, 0.7, 0.501, 0.6, 0.9, 0.50001]  # whatever it makes of its errors
    assert answered(errors, alphas).tolist() == alphas


def test_what_is_no_alarm_is_the_detectors_to_the_bit():
    alphas = [0.9, 0.3, 0.49, 0.9, 0.1]
    assert answered([3.0] * 5, alphas).tolist()[:3] == alphas[:3]
    assert answered([3.0] * 5, alphas)[3] < 1e-9
    assert answered([3.0] * 5, alphas)[4] == 0.1


def test_a_return_that_does_not_end_counts_as_one_each_time_patience_is_over():
    """By gamma 2, by 20, not by 200; never where n is 0."""
    high, given_up = told([50.0] * (3 * TICKS))
    assert high == [1] * (2 * TICKS + 1) + [0] * (TICKS - 1)
    assert np.flatnonzero(given_up).tolist() == [2 * TICKS]


def test_after_a_quiet_time_all_is_as_at_the_beginning():
    for quiet, heard in ((TICKS - 1, False), (TICKS, True)):
        errors = [3.0] + [0.0] * quiet + [3.0]
        assert (answered(errors)[-1] >= GUARD) == heard


def test_an_alarm_that_is_not_answered_is_no_quiet():
    errors = [3.0] + [0.0] * (TICKS - 2) + [3.0] + [0.0] * (TICKS - 1) + [3.0]
    assert np.flatnonzero(answered(errors) >= GUARD).tolist() == [0]


@given(st.lists(st.floats(0.0, 1e9), min_size=1, max_size=60), st.floats(1.01, 1e6))
def test_it_never_adds_an_alarm_and_stays_finite(errors, factor):
    own = np.array([alpha_of(np.array([e]), BETA, GAMMA) for e in errors])
    found = answered(errors, factor=factor)
    assert np.all(found <= own)
    assert np.all((found >= 0.0) & (found <= 1.0))


@pytest.mark.parametrize(("error", "returns"), [(19.0, 1), (150.0, 2), (201.0, 100)])
def test_a_fault_that_stays_is_answered_seldom_and_a_large_one_always(error, returns):
    """gamma is 2, then 20, then 200, and stays there."""
    assert MOST == 2
    high = answered(np.tile([error, error, 0.0, 0.0], 100)) >= GUARD
    assert (np.diff(high, prepend=False) & high).sum() == returns


@pytest.mark.parametrize("factor", [1.0, 0.5, 1e7, np.nan])
def test_a_factor_that_is_none_is_refused(factor):
    with pytest.raises(ValueError, match="factor is"):
        AlarmBackoff(criteria=1, factor=factor, period=PERIOD)


def test_what_it_adds_to_the_controller():
    policy = FakePolicy()

    def wires(**given):
        return wires_of(make_controller(policy=policy, detector=FarFromHome(policy), home_tolerance=0.1, **given))

    assert wires(backoff=10.0) - wires() == {
        "detector.alpha -> alarm_backoff.alpha",
        "detector.errors -> alarm_backoff.errors",
        "alarm_backoff.answered_alpha -> alpha_hold.u",
        "alarm_backoff.answered_alpha -> home_reset.alpha",
        "alarm_backoff.answered_alpha -> loop_closer.alpha",
        "alarm_backoff.given_up -> home_or_given_up.u1",
        "alarm_backoff.given_up -> given_up_hold.u",
        "home_reset.reset -> home_or_given_up.u0",
        "home_or_given_up.sum -> recurrent_policy.reset",
    }


def test_without_a_new_start_at_home_the_network_starts_anew_where_a_return_is_given_up():
    policy = FakePolicy()
    assert "alarm_backoff.given_up -> recurrent_policy.reset" in wires_of(
        make_controller(policy=policy, detector=FarFromHome(policy), backoff=10.0)
    )


@pytest.mark.parametrize("kind", [NeverDetector, lambda policy: OracleDetector(policy, 3)])
def test_a_detector_without_a_gamma_is_answered_always(kind):
    policy = FakePolicy()
    made = [wires_of(make_controller(policy=policy, detector=kind(policy), backoff=b)) for b in (None, 10.0)]
    assert made[0] == made[1]
    with pytest.raises(ValueError, match=r"factor is 1\.0"):
        make_controller(policy=policy, detector=kind(policy), backoff=1.0)


def test_what_does_not_go_with_it_is_refused():
    policy = FakePolicy()
    with pytest.raises(ValueError, match=r"backoff is 10.0, but the detector's gamma is an input: leave one"):
        make_controller(policy=policy, detector=DialledDetector(FarFromHome(policy)), backoff=10.0)
    recovery = RECOVERIES["hold"].build(policy, 3, PERIOD)
    with pytest.raises(ValueError, match=r"backoff is 10.0, but the recovery has a system of its own: leave one"):
        make_controller(policy=policy, detector=FarFromHome(policy), backoff=10.0, recovery=recovery)


def test_in_the_loop_a_return_is_given_up_and_the_network_starts_anew():
    """The detector never is content: one return of PATIENCE, then the network has the arm for good, from c_0 on."""
    policy = FakePolicy()
    controller = make_controller(policy=policy, detector=FarFromHome(policy, 0.1), home_tolerance=1e-9, backoff=10.0)
    error = abs(policy.scaling.scale(policy.initial_posture)[1]) / 0.1
    arm = TickArm(policy.initial_posture + np.array([0.2, 0.0, 0.0, 0.0]))  # of ticks it would take 200 to be home
    loop = ClosedLoop(controller, arm, ([1.0], BETA, 0.5 * error))
    rows = []
    for k in range(TICKS + 5):
        loop.after_tick(k)
        rows.append((loop.output("alpha")[0], loop.output("hidden_state")))
    alphas, states = map(np.array, zip(*rows, strict=True))
    assert np.flatnonzero(alphas < GUARD).tolist() == [*range(TICKS + 1, TICKS + 5)]
    anew = [np.array_equal(state, policy.initial_state) for state in states]
    assert np.flatnonzero(anew).tolist() == [TICKS]  # while the fingers keep their command
