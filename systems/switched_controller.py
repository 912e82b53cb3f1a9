"""The whole controller: image and posture in, command out (Fig. 2), for any arm with any number of joints."""

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Adder, AffineSystem, ConstantVectorSource, ZeroOrderHold

from systems.alarm_backoff import AlarmBackoff
from systems.alpha_mixer import AlphaMixer
from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import check_detector
from systems.finger_release import FingerRelease
from systems.home_reset import HomeReset
from systems.image_encoder import ImageEncoder
from systems.loop_closer import LoopCloser
from systems.posture_history import PostureHistory
from systems.recurrent_policy import RecurrentPolicy
from systems.regulated_mixer import RegulatedMixer


class SwitchedController(Diagram):
    """Follows the learned trajectory while the network recalls what the arm did; else brings the arm home.

    .. pydrake_system::

        name: SwitchedController
        input_ports: [rgb_image, posture]  # finger_gaps, gamma and active too, where told so
        output_ports: [desired_posture, rnn_step, regulator_step, alpha, errors, hidden_state, predicted_features,
          recalled_postures, measured_posture, features, network_input]  # given_up before them, with a backoff

    Inputs (read at the ticks only):
        rgb_image: ImageRgba8U of image_width x image_height pixels.
        posture: (M,) physical units: measured joint angles (rad), then the finger openings as commanded (m).
        finger_gaps: (M - J,) these openings as measured, m; only with `empty_below`.
        gamma: (1,) see systems/dialled_detector.py; active: (1,) see systems/detector.py; only with such a detector.
    Outputs (physical units; constant between ticks, but for the last two, which alone have direct feedthrough):
        desired_posture: (M,) the command m_k + dm; where the network starts anew, empty fingers open.
        rnn_step, regulator_step: (M,) dm^R_k and dm^L_k, or the recovery's step, per tick.
        alpha: (1,) alpha_k, which closed the loop at tick k and mixes until the next one. Of a recovery of its own: 1
            in the ticks in which that acts, else 0.
        errors: (E,) of the detector, what alpha_k came from; with a backoff, see AlarmBackoff.
        given_up: (1,) of AlarmBackoff; only with a `backoff`.
        hidden_state: (S,) c_k.
        predicted_features: (F,) f^R_{k+1}, in [-1, 1].
        recalled_postures: ((N + 1) M,) m^R_{k+1}, then m^R_{k-1}, ..., m^R_{k-N}, *scaled*, row by row.
        measured_posture: (M,) m_k.
        features: (F,) of the image, in [-1, 1]. Encodes when pulled.
        network_input: (M + F,) x_k, *scaled*: what the update at tick k feeds to the network, unless that starts anew
            (see HomeReset). Encodes when pulled, not where alpha_k is exactly 1: pull it at a tick, where the update
            needs it too.

    Inside, postures are scaled to [-1, 1] by the bounds in the policy's weight file. The updates of tick k read image
    and posture as they stand then, and alpha_k, which the detector makes of that posture and of state from the tick
    before; a hold keeps it for the mixer. The outputs after them are those of tick k. A publish event at the same time
    comes before the updates: it sees x_k and the features of tick k, and of all other outputs those of tick k - 1.
    """

    def __init__(
        self,
        encoder,
        policy,
        detector: System,
        *,
        joints: int,
        regulator_Q,
        regulator_R,
        joint_lower: np.ndarray,
        joint_upper: np.ndarray,
        speed_limits: np.ndarray,
        finger_openings: tuple[float, float],
        finger_thresholds: tuple[float, float],
        period: float = 0.1,
        image_width: int = 112,
        image_height: int = 112,
        home_tolerance=None,
        empty_below=None,
        recovery: System | None = None,
        backoff: float | None = None,
    ):
        """
        Args:
            encoder, policy: see models/inference.py, or any objects like ImageEncoder and RecurrentPolicy ask for.
            detector: any system that is one by systems/detector.py, for scaled postures, as
                `DETECTORS[...].build(policy, joints, arrays)` gives it. In a default Context it never fires: call
                `set_calibration`.
            joints: J, the first J components are brought home; the others are fingers.
            regulator_Q, regulator_R: cost of the deviation and of the step, see `systems.posture_regulator.lqr`.
            joint_lower, joint_upper: (M,) limits of the command, all components, physical units.
            speed_limits: (J,) largest speed of the joints' command, rad/s.
            finger_openings: closed, open: the two commands of every finger, m.
            finger_thresholds: predicted openings below which the fingers close and above which they open, m.
            period: T of the ticks, s.
            image_width, image_height: of the image at the port, pixels.
            home_tolerance: rad; the network starts anew at home, within so much a joint: see HomeReset. None: never,
                as in the paper.
            empty_below: m; where it starts anew, fingers measured to be nearer than this hold nothing and open: see
                FingerRelease. None: they stay as they are.
            recovery: in the LQR's place, see systems/recoveries/; None: the LQR.
            backoff: factor of AlarmBackoff, for the LQR alone; not behind a detector whose gamma is an input, and none
                behind one that has no gamma (`has_gamma`). None: each alarm is answered alike.
        """
        super().__init__()
        period = require_positive("period", period)
        size = policy.posture_size
        joints = require_count("joints", joints, maximum=size)
        joint_lower, joint_upper = require_bounds("joint_lower", joint_lower, "joint_upper", joint_upper, size)
        speed_limits = require_vector("speed_limits", speed_limits, joints, minimum=0.0)
        _check_fit(encoder, policy)
        check_detector(detector, policy)
        scaling = policy.scaling
        centre, half_range = scaling.centre, scaling.half_range
        initial = scaling.scale(require_vector("policy.initial_posture", policy.initial_posture, size))

        def scaled_fingers(values: tuple[float, float]) -> list[np.ndarray]:
            return [scaling.scale(np.full(size, value))[joints:] for value in values]

        builder = DiagramBuilder()

        def affine(name: str, factor: np.ndarray, offset: np.ndarray) -> AffineSystem:
            return builder.AddNamedSystem(name, AffineSystem(D=np.diag(factor), y0=offset))

        image_encoder = builder.AddNamedSystem("image_encoder", ImageEncoder(encoder, image_width, image_height))
        scale = affine("posture_scaling", 1.0 / half_range, -centre / half_range)
        rewinds = recovery is not None and recovery.HasOutputPort("memory")
        network = builder.AddNamedSystem("recurrent_policy", RecurrentPolicy(policy, period, rewinds))
        history = builder.AddNamedSystem(
            "posture_history",
            PostureHistory(posture_size=size, horizon=policy.horizon, period=period, initial_posture=initial),
        )
        closer = builder.AddNamedSystem("loop_closer", LoopCloser(posture_size=size, feature_size=policy.feature_size))
        builder.AddNamedSystem("detector", detector)
        sizes = dict(posture_size=size, joints=joints)
        limits = dict(
            lower=scaling.scale(joint_lower),
            upper=scaling.scale(joint_upper),
            max_step=speed_limits * period / half_range[:joints],
            finger_openings=scaled_fingers(finger_openings),
            finger_thresholds=scaled_fingers(finger_thresholds),
        )
        mixer: System
        if recovery is None:
            lqr = dict(initial_posture=initial, Q=regulator_Q, R=regulator_R, period=period)
            mixer = builder.AddNamedSystem("regulated_mixer", RegulatedMixer(**sizes, **lqr, **limits))
        else:
            mixer = builder.AddNamedSystem("alpha_mixer", AlphaMixer(**sizes, **limits))

        def wire(source: System, target: System, *names: str) -> None:
            for name in names:
                builder.Connect(source.GetOutputPort(name), target.GetInputPort(name))

        alpha, step, self._backoff = detector.GetOutputPort("alpha"), None, None
        if backoff is not None:
            if detector.HasInputPort("gamma") or recovery is not None:
                other = (
                    "the detector's gamma is an input" if recovery is None else "the recovery has a system of its own"
                )
                raise ValueError(f"backoff is {backoff}, but {other}: leave one of the two out.")
            criteria = detector.GetOutputPort("errors").size()
            made = AlarmBackoff(criteria=criteria, factor=backoff, period=period)
            self._backoff = made if getattr(detector, "has_gamma", True) else None
        if self._backoff is not None:
            builder.AddNamedSystem("alarm_backoff", self._backoff)
            wire(detector, self._backoff, "alpha", "errors")
            alpha = self._backoff.GetOutputPort("answered_alpha")
        closed_by = alpha
        if recovery is not None:
            builder.AddNamedSystem("recovery", recovery)
            builder.Connect(alpha, recovery.GetInputPort("alarm"))
            builder.Connect(scale.get_output_port(), recovery.GetInputPort("posture"))
            for name in ("hidden_state", "recalled_postures", "predicted_features"):
                if recovery.HasInputPort(name):
                    wire(network, recovery, name)
            if rewinds:
                wire(recovery, network, "memory")
            alpha, step = recovery.GetOutputPort("acting"), recovery.GetOutputPort("recovery_step")
            builder.Connect(step, mixer.GetInputPort("regulator_step"))
            # The network is fed what is measured all the while.
            closed_by = builder.AddNamedSystem("loop_stays_closed", ConstantVectorSource([0.0])).get_output_port()
        # Above 1/2: the network starts anew.
        reset = None if self._backoff is None else self._backoff.GetOutputPort("given_up")
        if home_tolerance is not None:
            tolerance = require_positive("home_tolerance", home_tolerance) / half_range[:joints]
            home = HomeReset(posture_size=size, initial_posture=initial[:joints], tolerance=tolerance)
            builder.AddNamedSystem("home_reset", home)
            builder.Connect(alpha, home.GetInputPort("alpha"))
            builder.Connect(scale.get_output_port(), home.GetInputPort("posture"))
            given_up, reset = reset, home.get_output_port()
            if given_up is not None:
                either = builder.AddNamedSystem("home_or_given_up", Adder(2, 1))
                builder.Connect(reset, either.get_input_port(0))
                builder.Connect(given_up, either.get_input_port(1))
                reset = either.get_output_port()
        elif empty_below is not None:
            raise ValueError(f"empty_below is {empty_below} without a home_tolerance: give both, or none.")
        if reset is not None:
            builder.Connect(reset, network.GetInputPort("reset"))
        # Between the ticks the detector compares the posture of now with the prediction of the next tick: what it said
        # at the tick is held.
        holds = {
            name: builder.AddNamedSystem(f"{name}_hold", ZeroOrderHold(period, detector.GetOutputPort(name).size()))
            for name in ("alpha", "errors")
        }
        if self._backoff is not None:
            held = builder.AddNamedSystem("given_up_hold", ZeroOrderHold(period, 1))
            builder.Connect(self._backoff.GetOutputPort("given_up"), held.get_input_port())
            builder.ExportOutput(held.get_output_port(), "given_up")

        builder.ExportInput(image_encoder.GetInputPort("rgb_image"), "rgb_image")
        if network.HasInputPort("rgb_image"):
            builder.ConnectInput("rgb_image", network.GetInputPort("rgb_image"))
        builder.ExportInput(scale.get_input_port(), "posture")
        # The updates of tick k need the posture of tick k; the command, the one that was sampled then.
        builder.Connect(scale.get_output_port(), closer.GetInputPort("posture"))
        builder.Connect(scale.get_output_port(), history.GetInputPort("posture"))
        wire(history, mixer, "posture")
        wire(history, detector, "posture_history")
        wire(image_encoder, closer, "features")
        wire(closer, network, "network_input")
        wire(network, closer, "predicted_posture", "predicted_features")
        wire(network, detector, "recalled_postures", "hidden_state")
        wire(network, mixer, "predicted_posture")
        builder.Connect(closed_by, closer.GetInputPort("alpha"))
        for source, name in ((image_encoder, "features"), (network, "predicted_features"), (closer, "network_input")):
            if detector.HasInputPort(name):
                wire(source, detector, name)
        if reset is not None and detector.HasInputPort("reset"):
            builder.Connect(reset, detector.GetInputPort("reset"))
        for name in ("gamma", "active"):
            if detector.HasInputPort(name):
                builder.ExportInput(detector.GetInputPort(name), name)
        for port, hold in zip((alpha, detector.GetOutputPort("errors")), holds.values(), strict=True):
            builder.Connect(port, hold.get_input_port())
        builder.Connect(holds["alpha"].get_output_port(), mixer.GetInputPort("alpha"))

        def unscaled(port, name: str, offset: np.ndarray | float) -> OutputPort:
            unscale = affine(f"{name}_unscaling", half_range, offset * np.ones(size))  # a difference has no offset
            builder.Connect(port, unscale.get_input_port())
            return unscale.get_output_port()

        command = unscaled(mixer.GetOutputPort("desired_posture"), "desired_posture", centre)
        if empty_below is not None:
            fingers = np.ones(size - joints)
            limits = dict(opening=finger_openings[1] * fingers, empty_below=empty_below * fingers)
            release = builder.AddNamedSystem(
                "finger_release", FingerRelease(posture_size=size, joints=joints, **limits)
            )
            held = builder.AddNamedSystem("reset_hold", ZeroOrderHold(period, 1))
            gaps = builder.AddNamedSystem("finger_gaps_hold", ZeroOrderHold(period, len(fingers)))
            assert reset is not None  # refused above
            builder.Connect(reset, held.get_input_port())
            builder.ExportInput(gaps.get_input_port(), "finger_gaps")
            for port, name in ((command, "desired_posture"), (held.get_output_port(), "reset"),
                               (gaps.get_output_port(), "finger_gaps")):  # fmt: skip
                builder.Connect(port, release.GetInputPort(name))
            command = release.get_output_port()
        builder.ExportOutput(command, "desired_posture")
        steps = mixer.GetOutputPort("rnn_step"), step or mixer.GetOutputPort("regulator_step")
        for port, name in zip(steps, ("rnn_step", "regulator_step"), strict=True):
            builder.ExportOutput(unscaled(port, name, 0.0), name)
        for name, hold in holds.items():
            builder.ExportOutput(hold.get_output_port(), name)
        for name in ("hidden_state", "predicted_features", "recalled_postures"):
            builder.ExportOutput(network.GetOutputPort(name), name)
        measured = unscaled(history.GetOutputPort("posture"), "measured_posture", centre)
        builder.ExportOutput(measured, "measured_posture")
        builder.ExportOutput(image_encoder.GetOutputPort("features"), "features")
        builder.ExportOutput(closer.GetOutputPort("network_input"), "network_input")
        builder.BuildInto(self)
        self._detector = detector

    def set_calibration(self, context: Context, mean_errors, beta: float, gamma: float) -> None:
        """Sets the detector's calibration (see CalibratedDetector) in `context`, the root Context; holds at once."""
        own = self._detector.GetMyMutableContextFromRoot(context)
        self._detector.set_calibration(own, mean_errors, beta, gamma)
        if self._backoff is not None:
            self._backoff.set_calibration(self._backoff.GetMyMutableContextFromRoot(context), beta, gamma)


def _check_fit(encoder, policy) -> None:
    """Raises ValueError if the policy was trained with another encoder, as far as the two tell."""
    if encoder.feature_size != policy.feature_size:
        raise ValueError(
            f"The encoder gives {encoder.feature_size} features, the policy takes {policy.feature_size}: load the "
            "encoder that the policy was trained with."
        )
    have, want = getattr(encoder, "hash", None), getattr(policy, "encoder_hash", None)
    if have is not None and want is not None and have != want:
        raise ValueError(
            f"The encoder's file has the hash {have}, the policy was trained with {want!s:.64}: load that encoder, or "
            "train the policy again."
        )
