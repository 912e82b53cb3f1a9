"""SwitchedController with fakes: the order of a tick, the times of the ticks, replays, and the return."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import PassThrough

from systems import alpha_mixer
from systems.detector import declare_detector_inputs
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


def test_loop_closing_at_tick_k_uses_alpha_of_the_tick_before():
    loop, policy, _ = closed_loop()
    scale = policy.scaling.scale
    features = 0.2 * np.arange(1, 5) / 4  # of the grey image, 51 / 255
    loop.after_tick(4)
    assert loop.output("alpha")[0] < 1e-100
    teleport(loop, 0.5)
    taken_to = loop.posture().copy()
    loop.simulator.AdvanceTo(4.75 * PERIOD)  # the arm moves to the command at 4.5 T ...
    teleport(loop, taken_to - loop.posture())  # ... and is taken away again
    loop.after_tick(5)
    # alpha_4 is 0: the network is fed what is measured at tick 5, not what was sampled at tick 4 ...
    assert policy.inputs[5] == pytest.approx(np.concatenate((scale(taken_to), features)))
    # ... and alpha_5, from the posture of tick 5 against the prediction made at tick 4, is 1.
    assert loop.output("alpha")[0] == pytest.approx(1.0)
    assert loop.output("posture_history")[:4] == pytest.approx(scale(taken_to))
    prediction = np.concatenate((policy.inputs[5][:4] + policy.drift, loop.output("predicted_features")))
    loop.after_tick(6)
    # alpha_5 is 1: tick 6 is fed the predictions made at tick 5.
    assert policy.inputs[6] == pytest.approx(prediction)


def reference(policy, arm, ticks, disturb, settling_ticks, dwell_ticks):
    """The equations' tick in numpy, the fingers waiting for settling_ticks, alpha down for dwell_ticks.

    Returns commands and alphas (ticks, ...).
    """
    lower, upper = policy.scaling.lower, policy.scaling.upper
    scale, unscale = policy.scaling.scale, lambda x: lower + (x + 1.0) * (upper - lower) / 2.0
    M, f = policy.posture_size, 0.2 * np.arange(1, 5) / 4
    initial = scale(policy.initial_posture)
    history, state = [initial] * (policy.horizon + 1), policy.initial_state
    prediction, predicted_features = initial, np.zeros(4)
    K = np.diag([0.1] * (M - 1) + [0.0])
    references, beta, gamma = policy.calibration

    def detect(recalled):
        errors = np.mean((np.array(history) - recalled)[:, :-1] ** 2, axis=1) / references
        return np.max(1.0 / (1.0 + np.exp(-np.clip(beta * (errors - gamma), -500.0, 500.0))))

    alpha = detect(np.tile(initial, (policy.horizon + 1, 1)))
    seen = [0.0] * settling_ticks + [alpha]
    commands, alphas = [], []
    for k in range(ticks):
        m = scale(arm + disturb(k))
        x = (1.0 - alpha) * np.concatenate((m, f)) + alpha * np.concatenate((prediction, predicted_features))
        y, state, recalled = policy.step(x, state)
        recalled = np.vstack((prediction, recalled))
        prediction, predicted_features = np.clip(y[:M], -1.0, 1.0), np.clip(y[M:], -1.0, 1.0)
        history = [m, *history[:-1]]
        fell = any(seen[-j] < 0.5 <= seen[-j - 1] for j in range(1, dwell_ticks + 1))
        alpha = 0.0 if fell else detect(recalled)
        seen.append(alpha)
        held = np.array([max(seen[-2:])] * (M - 1) + [max(seen[-1 - settling_ticks :])])
        arm = unscale(m + (1.0 - held) * (prediction - m) - K @ (m - initial))
        commands.append(arm)
        alphas.append(alpha)
    return np.array(commands), np.array(alphas)


@pytest.mark.parametrize(
    ("joints", "settling_ticks", "dwell_ticks"), [(1, 1, 0), (3, 1, 0), (7, 1, 0), (3, 4, 1), (3, 4, 3)]
)
def test_thirty_ticks_are_those_of_the_equations(joints, settling_ticks, dwell_ticks):
    def disturb(k):
        return 0.15 if k in (8, 9, 20) else 0.0

    policy = FakePolicy(joints=joints, gain=0.1)
    policy.calibration = np.full(3, 1e-4), 0.5, 2.0  # soft, so that alpha takes many values
    expected, alphas = reference(policy, policy.initial_posture, 30, disturb, settling_ticks, dwell_ticks)
    assert alphas.min() < 0.4
    assert alphas.max() > 0.9
    loop, policy, _ = closed_loop(policy, settling_ticks=settling_ticks, dwell_ticks=dwell_ticks)
    for k in range(30):
        if k:
            loop.simulator.AdvanceTo((k - 0.25) * PERIOD)
        teleport(loop, disturb(k))
        loop.after_tick(k)
        assert loop.output("alpha")[0] == pytest.approx(alphas[k], rel=1e-8)
        assert loop.output("desired_posture") == pytest.approx(expected[k], rel=1e-9)


class Scheduled(LeafSystem):
    """A detector with alpha = 1 in the ticks before `until`, then 0."""

    def __init__(self, until, policy):
        super().__init__()
        declare_detector_inputs(self, policy)
        self.set_calibration = lambda *_: None  # it has none
        self._until = until
        self.DeclareDiscreteState([0.0])  # the number of the next tick
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)
        for name in ("errors", "alpha"):
            self.DeclareVectorOutputPort(name, 1, self._calc, {self.xd_ticket()})

    def _update(self, context, discrete_state):
        discrete_state.set_value([context.get_discrete_state_vector()[0] + 1.0])

    def _calc(self, context, output):
        output[0] = float(context.get_discrete_state_vector()[0] - 1.0 < self._until)


def test_what_was_imagined_is_no_command():
    """As alpha falls, the predictions still come from imagination: they must not open the fingers."""
    policy = FakePolicy(drift=0.02)
    detector = Scheduled(20, policy)
    loop, *_ = closed_loop(policy, detector=detector, settling_ticks=3, dwell_ticks=1)
    start = policy.initial_posture
    half_range = (policy.scaling.upper - policy.scaling.lower) / 2.0
    loop.after_tick(19)
    assert loop.output("alpha")[0] == 1.0
    loop.after_tick(20)
    assert loop.output("alpha")[0] == 0.0
    # It imagined 21 steps of 0.02; the arm stays where the LQR holds it.
    assert start + loop.output("rnn_step") == pytest.approx(start + 21 * 0.02 * half_range)
    assert loop.output("desired_posture") == pytest.approx(start)
    # From then on what it predicts moves the joints, two ticks later the fingers.
    loop.after_tick(21)
    assert loop.output("desired_posture") == pytest.approx(start + 0.02 * half_range * np.array([1, 1, 1, 0]))
    loop.after_tick(22)
    assert loop.output("desired_posture")[-1] == pytest.approx(start[-1])
    loop.after_tick(23)
    assert loop.output("desired_posture")[-1] == pytest.approx(start[-1] + 0.02 * half_range[-1])


def test_outputs_are_physical_where_they_say_so():
    loop, policy, _ = closed_loop(offset=0.2)
    loop.after_tick(0)
    half_range = (policy.scaling.upper - policy.scaling.lower) / 2.0
    start = policy.initial_posture + 0.2
    pull = np.array([-0.02, -0.02, -0.02, 0.0])
    assert loop.output("regulator_step") == pytest.approx(pull)
    assert loop.output("rnn_step") == pytest.approx(0.01 * half_range)
    alpha = loop.output("alpha")[0]
    assert loop.output("desired_posture") == pytest.approx(start + (1 - alpha) * 0.01 * half_range + pull)
    assert loop.output("features") == pytest.approx(0.2 * np.arange(1, 5) / 4)


def test_speed_and_position_limits_are_physical():
    policy = FakePolicy(drift=0.5)
    start = policy.initial_posture
    room = np.array([9.0, 0.02, 0.05, 9.0])
    loop, *_ = closed_loop(policy, speed_limits=[0.3, 0.3, 100.0, 0.0], joint_upper=start + room)
    loop.after_tick(0)
    assert loop.output("desired_posture") == pytest.approx(start + np.array([0.03, 0.02, 0.05, 0.0]))


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
