"""The whole controller: image and posture in, command out (Fig. 2), for any arm with any number of joints."""

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System
from pydrake.systems.primitives import AffineSystem

from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import check_detector
from systems.dwell_time import DwellTime
from systems.image_encoder import ImageEncoder
from systems.loop_closer import LoopCloser
from systems.posture_history import PostureHistory
from systems.posture_regulator import lqr
from systems.recurrent_policy import RecurrentPolicy
from systems.regulated_mixer import RegulatedMixer


class SwitchedController(Diagram):
    """Follows the learned trajectory while the network recalls what the arm did; else brings the arm home.

    .. pydrake_system::

        name: SwitchedController
        input_ports: [rgb_image, posture]
        output_ports: [desired_posture, rnn_step, regulator_step, alpha, errors, hidden_state, predicted_features,
          recalled_postures, posture_history, features, network_input]

    Inputs (read at the ticks only):
        rgb_image: ImageRgba8U of image_width x image_height pixels.
        posture: (M,) physical units: measured joint angles (rad), then the finger openings as commanded (m).
    Outputs (physical units; constant between ticks, but for the last two, which alone have direct feedthrough):
        desired_posture: (M,) the command m_k + dm.
        rnn_step, regulator_step: (M,) dm^R_k and dm^L_k, per tick.
        alpha: (1,) alpha_k; the loop closing of tick k uses alpha_{k-1}.
        errors: (E,) of the detector.
        hidden_state: (S,) c_k.
        predicted_features: (F,) f^R_{k+1}, in [-1, 1].
        recalled_postures: ((N + 1) M,) m^R_k, m^R_{k-1}, ..., m^R_{k-N}, *scaled*, row by row.
        posture_history: ((N + 1) M,) m_k, m_{k-1}, ..., m_{k-N}, *scaled*, row by row.
        features: (F,) of the image, in [-1, 1]. Encodes when pulled.
        network_input: (M + F,) x_k, *scaled*: what the update at tick k feeds to the network. Encodes when pulled, not
            where alpha_{k-1} is exactly 1: pull it at a tick, where the update needs it too.

    Inside, postures are scaled to [-1, 1] by the bounds in the policy's weight file. An update at tick k reads image,
    posture and alpha as they stand before it; the outputs after it are those of tick k. A publish event at the same
    time comes before the update: it sees x_k and the features of tick k, and of all other outputs those of tick k - 1.
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
        period: float = 0.1,
        settling_ticks: int = 8,
        dwell_ticks: int = 3,
        image_width: int = 112,
        image_height: int = 112,
    ):
        """
        Args:
            encoder, policy: see models/inference.py, or any objects like ImageEncoder and RecurrentPolicy ask for.
            detector: any system that is one by systems/detector.py, for scaled postures, as
                `DETECTORS[...].build(policy, joints, arrays)` gives it. In a default Context it never fires: call
                `set_calibration`.
            joints: J, the first J components are brought home; the others are fingers.
            regulator_Q, regulator_R: cost of the deviation and of the step, see `systems.posture_regulator.lqr`. Their
                gain must be `policy.regulator_gain`, with which the network was trained.
            joint_lower, joint_upper: (M,) limits of the command, all components, physical units.
            speed_limits: (M,) largest speed of the command, physical units/s.
            period: T of the ticks, s.
            settling_ticks: D, how many ticks after the last one under alpha the network waits for the fingers; see
                AlphaMixer.
            dwell_ticks: W < D, how many ticks after alpha fell below 1/2 it is 0 whatever the detector says; see
                DwellTime.
            image_width, image_height: of the image at the port, pixels.
        """
        super().__init__()
        period = require_positive("period", period)
        size = policy.posture_size
        joints = require_count("joints", joints, maximum=size)
        joint_lower, joint_upper = require_bounds("joint_lower", joint_lower, "joint_upper", joint_upper, size)
        speed_limits = require_vector("speed_limits", speed_limits, size, minimum=0.0)
        _check_fit(encoder, policy)
        check_detector(detector, policy)
        _check_gain(policy, lqr(joints, regulator_Q, regulator_R, period)[0])
        scaling = policy.scaling
        centre, half_range = scaling.centre, scaling.half_range
        initial = scaling.scale(require_vector("policy.initial_posture", policy.initial_posture, size))

        builder = DiagramBuilder()

        def affine(name: str, factor: np.ndarray, offset: np.ndarray) -> AffineSystem:
            return builder.AddNamedSystem(name, AffineSystem(D=np.diag(factor), y0=offset))

        image_encoder = builder.AddNamedSystem("image_encoder", ImageEncoder(encoder, image_width, image_height))
        scale = affine("posture_scaling", 1.0 / half_range, -centre / half_range)
        network = builder.AddNamedSystem("recurrent_policy", RecurrentPolicy(policy, period))
        history = builder.AddNamedSystem(
            "posture_history",
            PostureHistory(posture_size=size, horizon=policy.horizon, period=period, initial_posture=initial),
        )
        closer = builder.AddNamedSystem("loop_closer", LoopCloser(posture_size=size, feature_size=policy.feature_size))
        builder.AddNamedSystem("detector", detector)
        dwell = builder.AddNamedSystem("dwell_time", DwellTime(history=settling_ticks, dwell_ticks=dwell_ticks))
        mixer = builder.AddNamedSystem(
            "regulated_mixer",
            RegulatedMixer(
                posture_size=size,
                joints=joints,
                initial_posture=initial,
                Q=regulator_Q,
                R=regulator_R,
                period=period,
                lower=scaling.scale(joint_lower),
                upper=scaling.scale(joint_upper),
                max_step=speed_limits * period / half_range,
                settling_ticks=settling_ticks,
            ),
        )
        # A history of any vector. Its update at tick k still sees the alpha of tick k - 1.
        alpha_history = builder.AddNamedSystem(
            "alpha_history",
            PostureHistory(posture_size=1, horizon=settling_ticks - 1, period=period, initial_posture=np.zeros(1)),
        )

        def wire(source: System, target: System, *names: str) -> None:
            for name in names:
                builder.Connect(source.GetOutputPort(name), target.GetInputPort(name))

        builder.ExportInput(image_encoder.GetInputPort("rgb_image"), "rgb_image")
        builder.ExportInput(scale.get_input_port(), "posture")
        # The update of tick k needs the posture of tick k; the command, the one that was sampled then.
        builder.Connect(scale.get_output_port(), closer.GetInputPort("posture"))
        builder.Connect(scale.get_output_port(), history.GetInputPort("posture"))
        wire(history, mixer, "posture")
        wire(history, detector, "posture_history")
        wire(image_encoder, closer, "features")
        wire(closer, network, "network_input")
        wire(network, closer, "predicted_posture", "predicted_features")
        wire(network, detector, "recalled_postures", "hidden_state")
        wire(network, mixer, "predicted_posture")
        builder.Connect(detector.GetOutputPort("alpha"), dwell.GetInputPort("detector_alpha"))
        wire(dwell, closer, "alpha")
        wire(dwell, mixer, "alpha")
        builder.Connect(dwell.GetOutputPort("alpha"), alpha_history.GetInputPort("posture"))
        for system in (dwell, mixer):
            builder.Connect(alpha_history.GetOutputPort("posture_history"), system.GetInputPort("last_alphas"))

        for name, offset in (("desired_posture", centre), ("rnn_step", 0.0), ("regulator_step", 0.0)):
            unscale = affine(f"{name}_unscaling", half_range, offset * np.ones(size))  # a difference has no offset
            builder.Connect(mixer.GetOutputPort(name), unscale.get_input_port())
            builder.ExportOutput(unscale.get_output_port(), name)
        for system, names in (
            (dwell, ("alpha",)),
            (detector, ("errors",)),
            (network, ("hidden_state", "predicted_features", "recalled_postures")),
            (history, ("posture_history",)),
            (image_encoder, ("features",)),
            (closer, ("network_input",)),
        ):
            for name in names:
                builder.ExportOutput(system.GetOutputPort(name), name)
        builder.BuildInto(self)
        self._detector = detector

    def set_calibration(self, context: Context, reference_errors, beta: float, gamma: float) -> None:
        """Sets the detector's calibration (see CalibratedDetector) in `context`, the root Context; holds at once."""
        own = self._detector.GetMyMutableContextFromRoot(context)
        self._detector.set_calibration(own, reference_errors, beta, gamma)


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
            f"The encoder's file has the hash {have}, the policy was trained with {want}: load that encoder, or train "
            "the policy again."
        )


def _check_gain(policy, gain: np.ndarray) -> None:
    """Raises ValueError unless `gain` (J, J) is the policy's gain times the identity, to 1e-4 of it."""
    trained = float(policy.regulator_gain)
    if not np.allclose(gain, trained * np.eye(len(gain)), rtol=0.0, atol=1e-4 * abs(trained)):
        raise ValueError(
            f"regulator_Q and regulator_R give the LQR gain {np.array2string(gain, precision=6)}, the policy was "
            f"trained with {trained:g} times the identity (limit: 1e-4 of that), and has learned the residual of it: "
            "set Q and R of the training, or train again."
        )
