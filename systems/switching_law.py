"""The switching law: all of the controller that is pure mathematics, as one Diagram that converts whole."""

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from systems.detector import check_detector
from systems.dwell_time import DwellTime
from systems.loop_closer import LoopCloser
from systems.regulated_mixer import RegulatedMixer


class SwitchingLaw(Diagram):
    """Wires detector, dwell time, loop closer and mixer; no state of its own, everything scaled and dimensionless.

    .. pydrake_system::

        name: SwitchingLaw
        input_ports:
        - posture
        - features
        - predicted_posture
        - predicted_features
        - posture_history
        - recalled_postures
        - hidden_state
        - sampled_posture
        - last_alphas
        output_ports:
        - network_input
        - errors
        - alpha
        - desired_posture
        - rnn_step
        - regulator_step

    Inputs:
        posture: (M,) m_k as it stands before the tick's update; only `network_input` depends on it.
        features: (F,) f_k; only `network_input` depends on it.
        predicted_posture, predicted_features: (M,), (F,) the network's predictions for the next tick.
        posture_history: ((N + 1) M,) m_k, ..., m_{k-N}.
        recalled_postures: ((N + 1) M,) m^R_k, ..., m^R_{k-N}.
        hidden_state: (S,) c_k.
        sampled_posture: (M,) m_k as sampled at the tick.
        last_alphas: (D,) alpha_{k-1}, ..., alpha_{k-D}; see AlphaMixer.
    Outputs:
        network_input: (M + F,) x of Eqs. 7 and 8.
        errors: (E,) of the detector.
        alpha: (1,) of the detector, 0 in the dwell time after it fell.
        desired_posture: (M,) the command m_k + dm, within limits.
        rnn_step, regulator_step: (M,) dm^R and dm^L of Eq. 3, per tick.

    Converts to AutoDiffXd if the detector does; the result is a plain Diagram with the same ports.
    """

    def __init__(
        self,
        *,
        posture_size: int,
        feature_size: int,
        horizon: int,
        state_size: int,
        detector: System,
        mixer: RegulatedMixer,
        dwell_ticks: int = 0,
    ):
        """
        Args:
            posture_size, feature_size, horizon, state_size: M, F, N, S.
            detector: any system that is one by systems/detector.py; becomes part of this Diagram.
            mixer: in scaled units; becomes part of this Diagram.
            dwell_ticks: W < D; see DwellTime.
        """
        super().__init__()
        check_detector(detector, posture_size=posture_size, horizon=horizon, state_size=state_size)
        builder = DiagramBuilder()
        closer = builder.AddNamedSystem("loop_closer", LoopCloser(posture_size=posture_size, feature_size=feature_size))
        builder.AddNamedSystem("detector", detector)
        builder.AddNamedSystem("regulated_mixer", mixer)
        history = mixer.GetInputPort("last_alphas").size()
        dwell = builder.AddNamedSystem("dwell_time", DwellTime(history=history, dwell_ticks=dwell_ticks))
        builder.Connect(detector.GetOutputPort("alpha"), dwell.GetInputPort("detector_alpha"))
        alpha = dwell.GetOutputPort("alpha")
        builder.Connect(alpha, closer.GetInputPort("alpha"))
        builder.Connect(alpha, mixer.GetInputPort("alpha"))

        for name in ("posture", "features", "predicted_posture", "predicted_features"):
            builder.ExportInput(closer.GetInputPort(name), name)
        for name in ("posture_history", "recalled_postures", "hidden_state"):
            builder.ExportInput(detector.GetInputPort(name), name)
        builder.ExportInput(mixer.GetInputPort("posture"), "sampled_posture")
        builder.ExportInput(mixer.GetInputPort("last_alphas"), "last_alphas")
        builder.ConnectInput("predicted_posture", mixer.GetInputPort("predicted_posture"))
        builder.ConnectInput("last_alphas", dwell.GetInputPort("last_alphas"))
        builder.ExportOutput(closer.GetOutputPort("network_input"), "network_input")
        builder.ExportOutput(detector.GetOutputPort("errors"), "errors")
        builder.ExportOutput(alpha, "alpha")
        for name in ("desired_posture", "rnn_step", "regulator_step"):
            builder.ExportOutput(mixer.GetOutputPort(name), name)
        builder.BuildInto(self)
