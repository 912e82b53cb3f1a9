"""The switching law: all of the controller that is pure mathematics, as one Diagram that converts whole."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from systems.alpha_mixer import AlphaMixer
from systems.detector import check_detector
from systems.dwell_time import DwellTime
from systems.loop_closer import LoopCloser


class SwitchingLaw(Diagram):
    """Wires detector, dwell time, loop closer, regulator and mixer; no state of its own, everything scaled and dimensionless.

    .. pydrake_system::

        name: SwitchingLaw
        input_ports:
        - posture
        - features
        - sampled_posture
        - posture_history
        - predicted_posture
        - predicted_features
        - recalled_postures
        - hidden_state
        - last_alphas
        output_ports:
        - network_input
        - errors
        - alpha
        - desired_posture
        - rnn_step
        - regulator_step
        - step

    Inputs:
        posture: (M,) m_k as it stands before the tick's update; only `network_input` depends on it.
        features: (F,) f_k; only `network_input` depends on it.
        sampled_posture: (M,) m_k as sampled at the tick.
        posture_history: ((N + 1) M,) m_k, ..., m_{k-N}.
        predicted_posture, predicted_features: (M,), (F,) the network's predictions for the next tick.
        recalled_postures: ((N + 1) M,) m^R_k, ..., m^R_{k-N}.
        hidden_state: (S,) c_k.
        last_alphas: (D,) alpha_{k-1}, ..., alpha_{k-D}; see AlphaMixer.
    Outputs:
        network_input: (M + F,) x of Eqs. 7 and 8.
        errors: (E,) of the detector.
        alpha: (1,) of the detector, 0 in the dwell time after it fell.
        desired_posture: (M,) the command m_k + dm, within limits.
        rnn_step, regulator_step, step: (M,) dm^R, dm^L and dm of Eq. 3, per tick.

    Converts to AutoDiffXd and Expression if the detector does; the result is a plain Diagram with the same ports.
    """

    def __init__(
        self,
        *,
        posture_size: int,
        feature_size: int,
        horizon: int,
        state_size: int,
        detector: System,
        regulator: System,
        lower: np.ndarray,
        upper: np.ndarray,
        max_step: np.ndarray,
        settling_ticks: int = 1,
        dwell_ticks: int = 0,
        joints: int = 0,
    ):
        """
        Args:
            posture_size, feature_size, horizon, state_size: M, F, N, S.
            detector: any system with the ports that systems/detector.py lists; becomes part of this Diagram.
            regulator: of `make_posture_regulator`, in scaled units; becomes part of this Diagram.
            lower, upper, max_step: (M,) limits of the command and of its step a tick, scaled; see AlphaMixer.
            settling_ticks: D; joints: J; see AlphaMixer.
            dwell_ticks: W < D; see DwellTime.
        """
        super().__init__()
        check_detector(detector, posture_size=posture_size, horizon=horizon, state_size=state_size)
        builder = DiagramBuilder()
        closer = builder.AddNamedSystem("loop_closer", LoopCloser(posture_size=posture_size, feature_size=feature_size))
        detector = builder.AddNamedSystem("detector", detector)
        regulator = builder.AddNamedSystem("posture_regulator", regulator)
        mixer = builder.AddNamedSystem(
            "alpha_mixer",
            AlphaMixer(
                posture_size=posture_size,
                lower=lower,
                upper=upper,
                max_step=max_step,
                settling_ticks=settling_ticks,
                joints=joints,
            ),
        )
        dwell = builder.AddNamedSystem("dwell_time", DwellTime(history=settling_ticks, dwell_ticks=dwell_ticks))
        builder.Connect(detector.GetOutputPort("alpha"), dwell.GetInputPort("detector_alpha"))
        alpha = dwell.GetOutputPort("alpha")
        builder.Connect(alpha, closer.GetInputPort("alpha"))
        builder.Connect(alpha, mixer.GetInputPort("alpha"))
        builder.Connect(regulator.GetOutputPort("step"), mixer.GetInputPort("regulator_step"))

        for name, consumers in {
            "posture": [closer.GetInputPort("posture")],
            "features": [closer.GetInputPort("features")],
            "sampled_posture": [mixer.GetInputPort("posture"), regulator.GetInputPort("posture")],
            "posture_history": [detector.GetInputPort("posture_history")],
            "predicted_posture": [closer.GetInputPort("predicted_posture"), mixer.GetInputPort("predicted_posture")],
            "predicted_features": [closer.GetInputPort("predicted_features")],
            "recalled_postures": [detector.GetInputPort("recalled_postures")],
            "hidden_state": [detector.GetInputPort("hidden_state")],
            "last_alphas": [mixer.GetInputPort("last_alphas"), dwell.GetInputPort("last_alphas")],
        }.items():
            builder.ExportInput(consumers[0], name)
            for consumer in consumers[1:]:
                builder.ConnectInput(name, consumer)
        builder.ExportOutput(closer.GetOutputPort("network_input"), "network_input")
        builder.ExportOutput(detector.GetOutputPort("errors"), "errors")
        builder.ExportOutput(alpha, "alpha")
        for name in ("desired_posture", "rnn_step", "regulator_step", "step"):
            builder.ExportOutput(mixer.GetOutputPort(name), name)
        builder.BuildInto(self)
