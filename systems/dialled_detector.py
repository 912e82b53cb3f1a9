"""A detector whose gamma can be turned while it runs."""

import math

from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem, System

from systems.arguments import require_positive
from systems.detector import FURTHER, alpha_of


class GammaDial(LeafSystem):
    """alpha with another gamma than the detector's own.

    .. pydrake_system::

        name: GammaDial
        input_ports: [errors, alpha, gamma]
        output_ports: [dialled_alpha]

    Inputs:
        errors, alpha: (E,) and (1,) of a detector, see systems/detector.py.
        gamma: (1,) dimensionless; NaN: the detector's own.
    Outputs:
        dialled_alpha: (1,) `alpha` where gamma is NaN, else that of `errors` by Eqs. 5 and 6. Direct feedthrough.

    beta is a parameter of the Context.
    """

    def __init__(self, criteria: int):
        """`criteria`: E."""
        super().__init__()
        self._errors = self.DeclareVectorInputPort("errors", criteria)
        self._alpha, self._gamma = (self.DeclareVectorInputPort(name, 1) for name in ("alpha", "gamma"))
        self._beta = self.DeclareNumericParameter(BasicVector([1.0]))
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("dialled_alpha", 1, self._calc_alpha, reads)

    def set_beta(self, context: Context, beta: float) -> None:
        """Sets the slope, > 0, in this system's `context`."""
        context.get_mutable_numeric_parameter(self._beta).SetFromVector([require_positive("beta", beta)])

    def _calc_alpha(self, context: Context, output: BasicVector) -> None:
        gamma = float(self._gamma.Eval(context)[0])
        if math.isnan(gamma):
            output[0] = self._alpha.Eval(context)[0]
        else:
            output[0] = alpha_of(self._errors.Eval(context), context.get_numeric_parameter(self._beta)[0], gamma)


class DialledDetector(Diagram):
    """A detector with one input more: all else is as of the detector that it wraps.

    .. pydrake_system::

        name: DialledDetector
        input_ports: [posture_history, recalled_postures, hidden_state, gamma]  # and further ones, of the wrapped
        output_ports: [errors, alpha]

    Ports: see systems/detector.py; gamma (1,): see GammaDial.
    """

    def __init__(self, detector: System):
        """`detector`: any, see systems/detector.py."""
        super().__init__()
        builder = DiagramBuilder()
        self._detector = builder.AddNamedSystem("own_gamma", detector)
        self._dial = builder.AddNamedSystem("dial", GammaDial(detector.GetOutputPort("errors").size()))
        for name in ("posture_history", "recalled_postures", "hidden_state", *FURTHER):
            if detector.HasInputPort(name):
                builder.ExportInput(detector.GetInputPort(name), name)
        builder.ExportInput(self._dial.GetInputPort("gamma"), "gamma")
        for name in ("errors", "alpha"):
            builder.Connect(detector.GetOutputPort(name), self._dial.GetInputPort(name))
        builder.ExportOutput(detector.GetOutputPort("errors"), "errors")
        builder.ExportOutput(self._dial.get_output_port(), "alpha")
        builder.BuildInto(self)

    def set_calibration(self, context: Context, mean_errors, beta: float, gamma: float) -> None:
        """As of the detector that it wraps, in `context`, this system's own."""
        self._dial.set_beta(self.GetMutableSubsystemContext(self._dial, context), beta)
        self._detector.set_calibration(
            self.GetMutableSubsystemContext(self._detector, context), mean_errors, beta, gamma
        )
