"""What is logged at the ticks of a controller, and of what watches it, under the names that a Record has."""

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput, Multiplexer

from systems.switched_controller import SwitchedController

COMMAND = "desired_posture"  # as it comes out of the clearance filter
# Outputs that are logged, under their own names: of the controller, and of what watches it.
LOGGED = ("rnn_step", "regulator_step", COMMAND, "errors", "hidden_state", "predicted_features", "signals")


class RunLog:
    """Drake's logs in a diagram. They see a tick before its update: what the network is fed; all else is of the last.

    `sinks`: the two log sinks.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        controller: SwitchedController,
        command: OutputPort,
        signals: OutputPort,
        period: float,
    ):
        """`command`: in the place of the controller's own; `signals`: see RequirementSignals; `period`: s."""
        others = {COMMAND: command, "signals": signals}
        logged = [others.get(name) or controller.GetOutputPort(name) for name in LOGGED]
        self._sizes = [port.size() for port in logged]
        self._logged = builder.AddNamedSystem("logged", Multiplexer(self._sizes))
        for i, port in enumerate(logged):
            builder.Connect(port, self._logged.get_input_port(i))
        self._log = LogVectorOutput(self._logged.get_output_port(), builder, period)
        self._input_log = LogVectorOutput(controller.GetOutputPort("network_input"), builder, period)
        self._log.set_name("log")
        self._input_log.set_name("network_input_log")
        self.sinks = self._log, self._input_log

    def latest(self, root: Context) -> dict[str, np.ndarray]:
        """What a Record has of the present tick and is logged, by name; the logs are emptied. For runs without end."""
        parts = self._logged.get_output_port().Eval(self._logged.GetMyContextFromRoot(root))
        found = dict(zip(LOGGED, np.split(parts, np.cumsum(self._sizes)[:-1]), strict=True))
        found["network_input"] = self._input_log.FindLog(root).data()[:, -1].copy()
        for log in self.sinks:
            log.FindMutableLog(root).Clear()
        return found

    def rows(self, root: Context, ticks: int) -> dict[str, np.ndarray]:
        """What was logged of the first `ticks` ticks, (ticks, size) by name."""
        last = self._logged.get_output_port().Eval(self._logged.GetMyContextFromRoot(root))
        rows = np.vstack((self._log.FindLog(root).data().T[1:], last))[:ticks]
        parts = np.split(rows, np.cumsum(self._sizes)[:-1], axis=1)
        network_input = self._input_log.FindLog(root).data().T[:ticks]
        return dict(zip((*LOGGED, "network_input"), map(np.ascontiguousarray, (*parts, network_input)), strict=True))
