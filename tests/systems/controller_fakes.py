"""Numpy stand-ins for the encoder and the policy, and a world with an arm that is a plain integrator."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource, LogVectorOutput
from pydrake.systems.sensors import ImageRgba8U

from models.data.scaling import MinMaxScaling
from systems.detectors import DETECTORS
from systems.switched_controller import SwitchedController

PERIOD = 0.1


@dataclass
class FakeEncoder:
    """The mean intensity, times 1, 2, ... , as features."""

    feature_size: int = 4
    calls: int = 0
    log: list = field(default_factory=list)
    name: str = "encode"

    def encode(self, rgb):
        assert (rgb.dtype, rgb.shape[2]) == (np.uint8, 3)
        self.calls += 1
        self.log.append(self.name)
        return rgb.mean() / 255.0 * np.arange(1, self.feature_size + 1) / self.feature_size


class FakePolicy:
    """Predicts `drift` from its input; its state is the last horizon inputs' postures, so it recalls exactly what it
    was fed, plus `nonsense`."""

    def __init__(self, joints=3, feature_size=4, horizon=2, drift=0.01, nonsense=0.0):
        self.posture_size = joints + 1
        self.feature_size = feature_size
        self.horizon = horizon
        self.state_size = (horizon + 1) * self.posture_size
        self.scaling = MinMaxScaling(-2.0 * np.ones(self.posture_size), np.arange(1.0, self.posture_size + 1))
        self.initial_posture = np.linspace(-0.5, 0.5, self.posture_size)
        self.initial_state = np.tile(self.scaling.scale(self.initial_posture), horizon + 1)
        self.calibration = np.full(horizon + 1, 1e-4), 30.0, 60.0  # mean errors, beta, gamma
        self.drift, self.nonsense = drift, nonsense
        self.inputs, self.log = [], []

    def step(self, x, state):
        self.inputs.append(np.array(x))
        self.log.append("step")
        m = x[: self.posture_size]
        features = 0.5 * x[self.posture_size :]
        after = np.concatenate((m, state[: -self.posture_size]))
        recalled = after[self.posture_size :].reshape(self.horizon, self.posture_size) + self.nonsense
        return np.concatenate((m + self.drift, features)), after, recalled


class TickArm(LeafSystem):
    """An arm that is a plain integrator with a hold: its posture at tick k + 1 is the command of tick k.

    Steps half a period after the ticks, so that it's clear what each of them sees.
    """

    def __init__(self, initial_posture, period=PERIOD):
        super().__init__()
        self._input = self.DeclareVectorInputPort("desired_posture", len(initial_posture))
        self._posture = self.DeclareDiscreteState(np.asarray(initial_posture, dtype=float))
        self.DeclareStateOutputPort("posture", self._posture)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period / 2, self._update)

    def _update(self, context, discrete_state):
        discrete_state.set_value(self._posture, self._input.Eval(context))


def image(value=51, size=112):
    """A grey image, size x size pixels."""
    picture = ImageRgba8U(size, size)
    picture.mutable_data[:] = value
    return picture


def make_controller(encoder=None, policy=None, detector=None, **arguments):
    """A controller with wide limits around fakes; its detector is not calibrated."""
    policy = policy or FakePolicy()
    n = policy.posture_size
    defaults = dict(
        joints=n - 1,
        regulator_Q=1.0,
        regulator_R=90.0,
        joint_lower=np.full(n, -10.0),
        joint_upper=np.full(n, 10.0),
        speed_limits=np.full(n - 1, 100.0),
        finger_openings=(-1.0, 1.0),
        finger_thresholds=(-0.25, 0.25),
        period=PERIOD,
    )
    encoder = encoder or FakeEncoder(policy.feature_size)
    detector = detector or DETECTORS["recall"].build(policy, n - 1, {})
    return SwitchedController(encoder, policy, detector, **(defaults | arguments))


class Camera(LeafSystem):
    """A grey image that is brighter at every tick, and that between them is as bright as at the next one."""

    def __init__(self):
        super().__init__()
        make = lambda: AbstractValue.Make(ImageRgba8U(112, 112))  # noqa: E731
        self.DeclareAbstractOutputPort("rgb_image", make, self._calc, {self.time_ticket()})

    def _calc(self, context, output):
        output.get_mutable_value().mutable_data[:] = self.intensity(int(np.ceil(context.get_time() / PERIOD - 1e-6)))

    @staticmethod
    def intensity(k):
        """At tick k: 0 to 255."""
        return 20 + 37 * k % 200


class ClosedLoop:
    """The controller with a calibration, a camera (a grey image if None), and an arm; optionally a log of an output at
    the ticks. A detector that asks is told that the arm is disturbed. `finger_gaps`: the source of what is measured of
    the fingers, where the controller asks for it."""

    def __init__(self, controller, arm, calibration, logged=None, camera=None, finger_gaps=None):
        builder = DiagramBuilder()
        self.controller = builder.AddNamedSystem("controller", controller)
        self.arm = builder.AddNamedSystem("arm", arm)
        camera = builder.AddNamedSystem("camera", camera or ConstantValueSource(AbstractValue.Make(image())))
        builder.Connect(camera.get_output_port(), controller.GetInputPort("rgb_image"))
        builder.Connect(arm.get_output_port(), controller.GetInputPort("posture"))
        builder.Connect(controller.GetOutputPort("desired_posture"), arm.get_input_port())
        if controller.HasInputPort("active"):
            disturbed = builder.AddNamedSystem("active", ConstantVectorSource([1.0]))
            builder.Connect(disturbed.get_output_port(), controller.GetInputPort("active"))
        if finger_gaps is not None:
            builder.AddSystem(finger_gaps)
            builder.Connect(finger_gaps.get_output_port(), controller.GetInputPort("finger_gaps"))
        self.log = None if logged is None else LogVectorOutput(controller.GetOutputPort(logged), builder, PERIOD)
        self.diagram = builder.Build()  # raises on an algebraic loop
        self.calibration = calibration
        self.simulator = Simulator(self.diagram, self.fresh_context())
        self.simulator.Initialize()

    def fresh_context(self):
        context = self.diagram.CreateDefaultContext()
        self.controller.set_calibration(context, *self.calibration)
        return context

    def output(self, name):
        context = self.controller.GetMyContextFromRoot(self.simulator.get_context())
        return self.controller.GetOutputPort(name).Eval(context)

    def posture(self):
        return self.arm.get_output_port().Eval(self.arm.GetMyContextFromRoot(self.simulator.get_context()))

    def after_tick(self, k):
        """Advances to just after the update of tick k, before the arm moves."""
        self.simulator.AdvanceTo(k * PERIOD + 0.25 * PERIOD)
        return self
