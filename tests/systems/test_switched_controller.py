"""SwitchedController with fakes: the order of a tick, the times of the ticks, replays, and the return."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import PassThrough

from systems import alpha_mixer
from tests.systems.controller_fakes import PERIOD, ClosedLoop, FakeEncoder, FakePolicy, TickArm, make_controller
from tests.systems.system_checks import snapshot


def closed_loop(policy=None, offset=0.0, arm=None, logged=None, **arguments):
    """Returns the loop, the policy and the encoder; the arm starts `offset` from the initial posture."""
    policy = policy or FakePolicy()
    encoder = FakeEncoder(policy.feature_size, log=policy.log)
    arm = arm or TickArm(policy.initial_posture + offset)
    loop = ClosedLoop(make_controller(encoder, policy, **arguments), arm, policy.calibration, logged)
    return loop, policy, encoder


def teleport(loop, offset):
    """Moves the arm, as somebody who takes it by the hand."""
    context = loop.arm.GetMyMutableContextFromRoot(loop.simulator.get_mutable_context())
    context.SetDiscreteState(loop.posture() + offset)


@pytest.mark.parametrize("joints", [1, 3, 7])
def test_no_algebraic_loop_even_with_an_arm_of_direct_feedthrough(joints):
    loop, policy, _ = closed_loop(FakePolicy(joints=joints), arm=PassThrough(joints + 1))
    loop.simulator.AdvanceTo(1.05)
    assert len(policy.inputs) == 11


def test_each_tick_encodes_and_steps_once_however_often_the_command_is_read():
    loop, policy, _ = closed_loop()
    for k in range(4):
        loop.after_tick(k)
        for name in ("desired_posture", "alpha", "rnn_step"):
            loop.output(name)
    assert policy.log == ["encode", "step"] * 4


def test_outputs_are_physical_where_they_say_so():
    loop, policy, _ = closed_loop(offset=0.2)
    loop.after_tick(0)
    half_range = (policy.scaling.upper - policy.scaling.lower) / 2.0
    start = policy.initial_posture + 0.2
    pull = np.array([-0.02, -0.02, -0.02, 0.0])
    assert loop.output("regulator_step") == pytest.approx(pull)
    assert loop.output("measured_posture") == pytest.approx(start)
    alpha = loop.output("alpha")[0]
    assert alpha == 1.0  # it expected to be at the initial posture: what it imagines goes on from there
    rnn_step = 0.01 * half_range - 0.2 - pull
    assert loop.output("rnn_step") == pytest.approx(rnn_step)
    assert loop.output("desired_posture") == pytest.approx(start + pull)
    loop.after_tick(0)
    assert loop.output("features") == pytest.approx(0.2 * np.arange(1, 5) / 4)


def test_speed_and_position_limits_are_physical():
    policy = FakePolicy(drift=0.5)
    start = policy.initial_posture
    room = np.array([9.0, 0.02, 0.05, 9.0])
    loop, *_ = closed_loop(policy, speed_limits=[0.3, 0.3, 100.0], joint_upper=start + room)
    loop.after_tick(0)
    assert loop.output("desired_posture")[:3] == pytest.approx(start[:3] + np.array([0.03, 0.02, 0.05]))


def test_arm_comes_home_at_the_rate_of_the_regulator_when_nothing_is_recalled():
    policy = FakePolicy(drift=0.3, nonsense=5.0)
    offset = np.array([0.4, -0.3, 0.2, 0.1])
    loop, *_ = closed_loop(policy, offset)
    for k in range(40):
        loop.after_tick(k)
        assert loop.output("alpha")[0] == 1.0
        left = np.append(0.9 ** (k + 1) * offset[:3], offset[3])  # the finger keeps its command
        assert loop.output("desired_posture") - policy.initial_posture == pytest.approx(left, abs=1e-8)
    assert np.abs(loop.posture() - policy.initial_posture)[:3].max() < 0.01


def test_ticks_stay_aligned_with_k_T_over_ten_minutes():
    policy = FakePolicy(joints=1, feature_size=1)
    loop, _, encoder = closed_loop(policy)
    times, step = [], policy.step

    def timed_step(x, state):
        times.append(loop.simulator.get_context().get_time())
        return step(x, state)

    policy.step = timed_step
    loop.simulator.AdvanceTo(600.05)
    assert times == [k * PERIOD for k in range(6001)]
    assert encoder.calls == 6001


def test_replay_from_a_cloned_context_gives_the_same_bits():
    loop, _, _ = closed_loop(offset=0.1)
    loop.after_tick(7)
    teleport(loop, 0.3)
    clone = loop.simulator.get_context().Clone()

    def run_on(context):
        simulator, snapshots = Simulator(loop.diagram, context), []
        for k in range(8, 30):
            simulator.AdvanceTo((k + 0.25) * PERIOD)
            snapshots.append(snapshot(loop.controller, loop.controller.GetMyContextFromRoot(context)))
        return snapshots

    second = run_on(clone)
    assert run_on(loop.simulator.get_context().Clone()) == second
    first = []
    for k in range(8, 30):
        loop.after_tick(k)
        context = loop.simulator.get_context()
        first.append(snapshot(loop.controller, loop.controller.GetMyContextFromRoot(context)))
    assert first == second


def test_a_fresh_context_is_a_fresh_episode():
    loop, *_ = closed_loop(offset=0.1)

    def episode():
        simulator = Simulator(loop.diagram, loop.fresh_context())
        simulator.AdvanceTo(2.05)
        context = simulator.get_context()
        return snapshot(loop.controller, loop.controller.GetMyContextFromRoot(context))

    assert episode() == episode()


def test_between_the_ticks_nothing_is_computed_again(monkeypatch):
    """A station asks for the command at each of its small steps; the mixer and the encoder work once a tick."""
    calls, clamp = [], alpha_mixer.clamp
    monkeypatch.setattr(alpha_mixer, "clamp", lambda *arguments: calls.append(1) or clamp(*arguments))
    loop, _, encoder = closed_loop(arm=TickArm(FakePolicy().initial_posture, period=0.002))
    loop.simulator.AdvanceTo(0.95)
    assert encoder.calls == 10
    assert len(calls) == 2 * 10  # two clamps a command


def test_a_log_at_the_tick_is_written_before_the_update():
    loop, *_ = closed_loop(logged="predicted_features")
    after = [np.zeros(4)]
    for k in range(5):
        loop.after_tick(k)
        after.append(loop.output("predicted_features").copy())
    assert after[1].any()
    logged = loop.log.FindLog(loop.simulator.get_context()).data().T
    assert logged == pytest.approx(np.array(after[:-1]))
