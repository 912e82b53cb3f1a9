"""Both controllers' steps and the switch between them: the LQR and Eq. 3 as one Diagram."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from systems.alpha_mixer import AlphaMixer
from systems.posture_regulator import make_posture_regulator


class RegulatedMixer(Diagram):
    """Wires AlphaMixer and the posture regulator, which gives its regulator_step.

    .. pydrake_system::

        name: RegulatedMixer
        input_ports: [posture, predicted_posture, alpha]
        output_ports: [desired_posture, rnn_step, regulator_step]

    Ports: see AlphaMixer; regulator_step (M,): dm^L_k. Postures scaled or physical, all in one unit.
    Direct feedthrough; no state; converts to AutoDiffXd, to a plain Diagram with the same ports.
    """

    def __init__(self, *, posture_size: int, joints: int, initial_posture: np.ndarray, Q, R, period: float, **limits):
        """
        Args:
            posture_size: M; joints: J <= M, the first J components are regulated, the others are fingers.
            initial_posture, Q, R, period: see `make_posture_regulator`.
            limits: lower, upper, max_step, finger_openings, finger_thresholds of AlphaMixer.
        """
        super().__init__()
        sizes = {"posture_size": posture_size, "joints": joints}
        builder = DiagramBuilder()
        regulator = make_posture_regulator(**sizes, initial_posture=initial_posture, Q=Q, R=R, period=period)
        mixer = AlphaMixer(**sizes, **limits)
        builder.AddNamedSystem("posture_regulator", regulator)
        builder.AddNamedSystem("alpha_mixer", mixer)
        builder.Connect(regulator.get_output_port(), mixer.GetInputPort("regulator_step"))
        for name in ("posture", "predicted_posture", "alpha"):
            builder.ExportInput(mixer.GetInputPort(name), name)
        builder.ConnectInput("posture", regulator.get_input_port())
        for name in ("desired_posture", "rnn_step"):
            builder.ExportOutput(mixer.GetOutputPort(name), name)
        builder.ExportOutput(regulator.get_output_port(), "regulator_step")
        builder.BuildInto(self)
