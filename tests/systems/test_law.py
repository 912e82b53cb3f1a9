"""The law, one tick: its seven steps by hand, and all of them together against the equations in plain numpy."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from models.data.scaling import MinMaxScaling
from systems.detector import declare_detector_inputs
from tests.systems.controller_fakes import PERIOD, Camera, ClosedLoop, FakeEncoder, FakePolicy, TickArm, make_controller

GREY = 0.2 * np.arange(1, 5) / 4  # the features of the grey image


class Scheduled(LeafSystem):
    """A detector that says `alphas` at the ticks, then 0; between them something else."""

    def __init__(self, policy, *alphas):
        super().__init__()
        declare_detector_inputs(self, policy)
        self.set_calibration = lambda *_: None  # it has none
        self._alphas = alphas
        for name in ("errors", "alpha"):
            self.DeclareVectorOutputPort(name, 1, self._calc, {self.time_ticket()})

    def _calc(self, context, output):
        k = context.get_time() / PERIOD
        at_tick = abs(k - round(k)) < 1e-6
        output[0] = (self._alphas[round(k)] if round(k) < len(self._alphas) else 0.0) if at_tick else 0.77


def scheduled(policy, *alphas, offset=0.0):
    controller = make_controller(policy=policy, detector=Scheduled(policy, *alphas))
    return ClosedLoop(controller, TickArm(policy.initial_posture + offset), [None] * 3).after_tick(0)


def push(loop, offset):
    """Moves the arm, as somebody who takes it by the hand."""
    context = loop.arm.GetMyMutableContextFromRoot(loop.simulator.get_mutable_context())
    context.SetDiscreteState(loop.posture() + offset)


def pushed_before(loop, k, offset):
    """From after tick k - 1 to after tick k, with a push between the two."""
    loop.simulator.AdvanceTo((k - 0.25) * PERIOD)
    push(loop, offset)
    return loop.after_tick(k)


def test_steps_1_and_5_the_network_is_fed_what_is_measured_at_this_tick():
    policy = FakePolicy()
    loop = scheduled(policy)
    pushed_before(loop, 1, [0.5, 0.0, 0.0, 0.0])
    expected = policy.initial_posture + np.array([0.5, 0.0, 0.0, 0.0]) + 0.01 * policy.scaling.half_range
    expected[-1] = 1.0  # the fingers as commanded: open, as 0.5 + 0.01 was predicted, more than the threshold 0.25
    assert loop.output("measured_posture") == pytest.approx(expected)
    assert policy.inputs[1] == pytest.approx(np.append(policy.scaling.scale(expected), GREY))


def test_step_3_the_prediction_is_judged_by_the_posture_of_its_tick():
    """l_0: it predicted a step of 0.01; the arm made it and was pushed by (0.3, 0, 0)."""
    policy = FakePolicy()
    loop = ClosedLoop(make_controller(policy=policy), TickArm(policy.initial_posture), (np.ones(3), 30.0, 1e6))
    loop.after_tick(3)
    assert loop.output("errors") == pytest.approx(np.zeros(3), abs=1e-12)
    pushed_before(loop, 4, [0.3, 0.0, 0.0, 0.0])
    scaled = 0.3 / policy.scaling.half_range[0]
    assert loop.output("errors") == pytest.approx([scaled**2 / 3, 0.0, 0.0])
    # The prediction that it makes now starts from where it is; what it recalls is where it was, pushed or not.
    loop.after_tick(5)
    assert loop.output("errors") == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize("n", [1, 2])
def test_step_3_what_is_recalled_is_judged_by_the_posture_of_its_tick(n):
    """The fake recalls exactly, of a moving arm, but for joint 2 in row n: off by 0.3. The fingers are not judged."""
    policy = FakePolicy(drift=0.02, horizon=2)
    policy.nonsense = np.zeros((2, 4))
    policy.nonsense[n - 1, 1] = 0.3
    policy.nonsense[:, 3] = 9.0
    means = np.array([1.0, 0.01, 0.02])
    loop = ClosedLoop(make_controller(policy=policy), TickArm(policy.initial_posture), (means, 30.0, 1e6))
    for k in range(1, 6):
        loop.after_tick(k)
        expected = np.zeros(3)
        expected[n] = 0.09 / 3 / means[n]
        assert loop.output("errors") == pytest.approx(expected, abs=1e-12)


def test_step_4_by_hand():
    """l = (0, 0.03, 0.03) over (1, 0.01, 0.02) is (0, 3, 1.5); beta = 2, gamma = 2.5."""
    policy = FakePolicy(nonsense=np.array([0.3, 0.0, 0.0, 0.0]))
    calibration = np.array([1.0, 0.01, 0.02]), 2.0, 2.5
    loop = ClosedLoop(make_controller(policy=policy), TickArm(policy.initial_posture), calibration).after_tick(1)
    assert loop.output("errors") == pytest.approx([0.0, 3.0, 1.5], abs=1e-6)  # alpha_0 is 0.007
    assert loop.output("alpha") == pytest.approx([1.0 / (1.0 + np.exp(-1.0))])


def test_step_4_alpha_is_known_before_the_network_steps():
    """At the tick of a push the network is already fed what it imagined, and no picture is encoded."""
    policy = FakePolicy()
    encoder = FakeEncoder(log=policy.log)
    loop = ClosedLoop(make_controller(encoder, policy), TickArm(policy.initial_posture), policy.calibration)
    loop.after_tick(4)
    assert loop.output("alpha")[0] < 1e-100
    imagined = np.append(policy.inputs[4][:4] + policy.drift, loop.output("predicted_features"))
    assert policy.log == ["encode", "step"] * 5
    pushed_before(loop, 5, [0.5, 0.0, 0.0, 0.0])
    assert loop.output("alpha")[0] == 1.0
    assert policy.inputs[5] == pytest.approx(imagined)
    assert policy.log == ["encode", "step"] * 5 + ["step"]


def test_steps_5_and_7_one_alpha_closes_the_loop_and_mixes():
    """alpha_2 = 0.3 alone: x_2 and the command of tick 2 have their shares by it, those of ticks 1 and 3 do not."""
    policy = FakePolicy(drift=0.02)
    home = policy.initial_posture
    loop = scheduled(policy, 0.0, 0.0, 0.3)
    for k, alpha in ((1, 0.0), (2, 0.3), (3, 0.0)):
        predicted = np.append(policy.inputs[-1][:4] + 0.02, loop.output("predicted_features"))
        pushed_before(loop, k, [0.1, 0.2, -0.1, 0.0])
        m = loop.output("measured_posture").copy()
        seen = np.append(policy.scaling.scale(m), GREY)
        assert policy.inputs[k] == pytest.approx((1.0 - alpha) * seen + alpha * predicted)
        next_posture = policy.scaling.unscale(policy.inputs[k][:4] + 0.02)  # m^R_{k+1}
        pull = -0.1 * (m - home)
        rnn_step = next_posture - m - pull
        rnn_step[-1] += pull[-1]  # the fingers have no LQR
        assert loop.output("alpha")[0] == alpha
        assert loop.output("rnn_step") == pytest.approx(rnn_step)
        # (1 - alpha) dm^R + dm^L is (1 - alpha) (m^R_{k+1} - m_k) + alpha dm^L.
        expected = (m + (1.0 - alpha) * (next_posture - m) + alpha * pull)[:3]
        assert loop.output("desired_posture")[:3] == pytest.approx(expected)


def test_step_6_predictions_are_clipped():
    policy = FakePolicy(drift=5.0)
    loop = scheduled(policy)
    assert loop.output("recalled_postures")[:4].tolist() == [1.0] * 4
    assert loop.output("desired_posture")[:3] == pytest.approx(policy.scaling.upper[:3])


def test_step_7_under_alpha_one_the_lqr_has_the_arm_and_the_fingers_keep_their_command():
    policy = FakePolicy(drift=0.3)
    loop = scheduled(policy, *[1.0] * 30, offset=[0.4, -0.3, 0.2, -1.5])  # closed fingers are -1, open ones 1
    for k in range(30):
        loop.after_tick(k)
        left = 0.9 ** (k + 1) * np.array([0.4, -0.3, 0.2])
        assert loop.output("desired_posture")[:3] - policy.initial_posture[:3] == pytest.approx(left, abs=1e-8)
        assert loop.output("desired_posture")[3] == policy.initial_posture[3] - 1.5
    loop.after_tick(30)  # alpha is 0: the fingers follow the prediction at once
    assert loop.output("desired_posture")[3] == pytest.approx(1.0 if policy.inputs[30][3] + 0.3 > 0 else -1.0)


def test_what_the_ports_say_is_held_between_the_ticks():
    policy = FakePolicy()
    loop = scheduled(policy, 0.0, 0.3, 1.0)
    for k, alpha in ((1, 0.3), (2, 1.0), (3, 0.0)):
        loop.after_tick(k)
        found = []
        for share in (0.3, 0.5, 0.99):
            loop.simulator.AdvanceTo((k + share) * PERIOD)
            push(loop, 0.1)
            names = ("alpha", "errors", "measured_posture", "desired_posture", "rnn_step", "hidden_state")
            found.append(np.concatenate([loop.output(name) for name in names]).tobytes())
        assert loop.output("alpha")[0] == loop.output("errors")[0] == alpha
        assert len(set(found)) == 1


class RandomNetwork:
    """c_k = tanh(A x_k + B c_{k-1}); prediction and recall are random functions of it: no two rows are alike."""

    def __init__(self, joints, seed, horizon=3, size=12):
        rng = np.random.default_rng(seed)
        M = self.posture_size = joints + 1
        self.feature_size, self.horizon, self.state_size = 4, horizon, size
        self.scaling = MinMaxScaling(-1.0 - rng.random(M), 1.0 + rng.random(M))
        self.initial_posture = np.append(rng.uniform(-0.3, 0.3, joints), 0.5)
        self.initial_state = np.zeros(size)
        self.calibration = 0.05 + 0.1 * rng.random(horizon + 1), 0.8, 3.0  # soft: alpha takes many values
        self._in, self._back = rng.normal(size=(size, M + 4)) / 2.0, rng.normal(size=(size, size)) / 2.5
        self._out, self._recall = rng.normal(size=(M + 4, size)) / 3.0, rng.normal(size=(horizon * M, size)) / 5.0
        self._out[M - 1] *= 3.0  # the opening crosses both thresholds

    def step(self, x, state):
        after = np.tanh(self._in @ x + self._back @ state)
        return self._out @ after, after, (self._recall @ after).reshape(self.horizon, -1)


def equations(network, pushes, fingers):
    """The seven steps, tick by tick; `pushes` (T, M) move the arm before each. Returns what each tick gave."""
    scale, unscale, N, J = network.scaling.scale, network.scaling.unscale, network.horizon, network.posture_size - 1
    home = scale(network.initial_posture)
    means, beta, gamma = network.calibration
    step_limit = fingers.speed * PERIOD / network.scaling.half_range[:J]
    c, m_R, f_R, recalled = network.initial_state, np.clip(home, -1, 1), np.zeros(4), [np.clip(home, -1, 1)] * N
    before = [home] * (N + 1)  # m_{k-1}, m_{k-2}, ..., m_{k-1-N}
    arm, found = network.initial_posture, []
    for k, offset in enumerate(pushes):
        m = scale(arm + offset)  # 1
        f = Camera.intensity(k) / 255.0 * np.arange(1, 5) / 4
        pairs = [(m_R, m)] + [(recalled[n - 1], before[n]) for n in range(1, N + 1)]  # 2
        errors = np.array([np.mean((a[:J] - b[:J]) ** 2) for a, b in pairs])  # 3
        alpha = max(1.0 / (1.0 + np.exp(-beta * (errors / means - gamma))))  # 4
        x = (1.0 - alpha) * np.append(m, f) + alpha * np.append(m_R, f_R)  # 5
        y, c, recalled = network.step(x, c)  # 6
        m_R, f_R = np.clip(y[: J + 1], -1.0, 1.0), np.clip(y[J + 1 :], -1.0, 1.0)
        dm_L = -0.1 * (m - home)[:J]  # 7
        dm_R = m_R[:J] - m[:J] - dm_L
        dm = np.clip((1.0 - alpha) * dm_R + dm_L, -step_limit, step_limit)
        command = np.append(np.clip(unscale(np.append(m[:J] + dm, 0.0))[:J], -fingers.limit, fingers.limit), 0.0)
        opening, command[J] = unscale(m_R)[J], unscale(m)[J]
        if alpha < 0.5 and opening > fingers.above:
            command[J] = fingers.open
        if alpha < 0.5 and opening < fingers.below:
            command[J] = fingers.closed
        found.append(dict(errors=errors / means, alpha=alpha, x=x, command=command, measured=unscale(m)))
        arm, before = command, [m, *before[:-1]]
    return found


@pytest.mark.parametrize(("joints", "seed"), [(1, 0), (3, 42), (7, 1), (7, 57)])
def test_forty_ticks_are_those_of_the_equations(joints, seed):
    network, rng = RandomNetwork(joints, seed), np.random.default_rng(seed)
    fingers = SimpleNamespace(closed=-0.5, open=0.5, below=-0.1, above=0.1, speed=5.0, limit=0.9)
    pushes = np.zeros((40, joints + 1))
    pushes[[8, 9, 20, 31], :joints] = rng.uniform(-0.6, 0.6, (4, joints))
    expected = equations(network, pushes, fingers)
    alphas, openings = np.array([row["alpha"] for row in expected]), np.array([row["command"][-1] for row in expected])
    assert alphas.min() < 0.2
    assert alphas.max() > 0.8
    assert np.count_nonzero(np.diff(openings)) > 2
    controller = make_controller(
        policy=network,
        speed_limits=np.full(joints, fingers.speed),
        joint_lower=np.full(joints + 1, -fingers.limit),
        joint_upper=np.full(joints + 1, fingers.limit),
        finger_openings=(fingers.closed, fingers.open),
        finger_thresholds=(fingers.below, fingers.above),
    )
    loop = ClosedLoop(
        controller, TickArm(network.initial_posture), network.calibration, "network_input", camera=Camera()
    )
    for k, row in enumerate(expected):
        if k:
            loop.simulator.AdvanceTo((k - 0.25) * PERIOD)
        push(loop, pushes[k])
        loop.after_tick(k)
        for port, name in (("errors", "errors"), ("desired_posture", "command"), ("measured_posture", "measured")):
            assert loop.output(port) == pytest.approx(row[name], rel=1e-7, abs=1e-9), (k, name)
        assert loop.output("alpha")[0] == pytest.approx(row["alpha"], rel=1e-7)
    logged = loop.log.FindLog(loop.simulator.get_context()).data().T
    assert logged == pytest.approx(np.array([row["x"] for row in expected]), abs=1e-8)
