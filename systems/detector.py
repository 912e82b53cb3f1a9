"""Detection of the unlearned situation: does the network recall what the arm did (Eqs. 5 and 6)?

A detector is any system with these ports, so that another one takes its place without another change:

    Inputs:
        posture_history: ((N + 1) M,) scaled m_k, m_{k-1}, ..., m_{k-N}, row by row.
        recalled_postures: ((N + 1) M,) scaled m^R_k (predicted), then m^R_{k-1}, ..., m^R_{k-N} (recalled).
        hidden_state: (S,) c_k of the network.
    Outputs:
        errors: (E,) what alpha comes from, one number a criterion (E is the detector's choice), each divided by what
            is large for it on normal runs.
        alpha: (1,) in [0, 1]; 0 on the learned way, 1 off it.

`declare_detector_inputs` declares the inputs; one that a detector doesn't need is left unread. A memory, if it needs
one, belongs in its Context as discrete state with the tick's period.
"""

import numpy as np
from pydrake.systems.framework import LeafSystem_, System
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count, require_positive, require_vector
from systems.elementwise import maximum, sigmoid


def declare_detector_inputs(system, *, posture_size: int, horizon: int, state_size: int) -> tuple:
    """Declares a detector's three input ports on `system`; returns them in the order of the module's docstring."""
    rows = (require_count("horizon", horizon) + 1) * require_count("posture_size", posture_size)
    return (
        system.DeclareVectorInputPort("posture_history", rows),
        system.DeclareVectorInputPort("recalled_postures", rows),
        system.DeclareVectorInputPort("hidden_state", require_count("state_size", state_size)),
    )


def check_detector(system: System, *, posture_size: int, horizon: int, state_size: int) -> None:
    """Raises ValueError unless `system` has a detector's ports with the sizes asked for."""
    rows = (horizon + 1) * posture_size
    inputs = {"posture_history": rows, "recalled_postures": rows, "hidden_state": state_size}
    outputs = {"errors": None, "alpha": 1}
    for has, get, wanted, kind in (
        (system.HasInputPort, system.GetInputPort, inputs, "input"),
        (system.HasOutputPort, system.GetOutputPort, outputs, "output"),
    ):
        for name, size in wanted.items():
            if not has(name):
                raise ValueError(
                    f"The detector {type(system).__name__} has no {kind} port `{name}`: declare the ports that the "
                    "docstring of systems/detector.py lists."
                )
            if size is not None and get(name).size() != size:
                raise ValueError(
                    f"The detector's {kind} port `{name}` has size {get(name).size()}, the policy asks for {size}: "
                    "build the detector with the policy's posture_size, horizon and state_size."
                )


@TemplateSystem.define("RecallDetector_")
def RecallDetector_(T):
    class Impl(LeafSystem_[T]):
        """alpha = max_n 1 / (1 + exp(-beta (l_n / r_n - gamma))), n = 0 .. N, Eqs. 5 and 6.

        l_n is the squared error of the recalled against the measured posture at tick k - n, averaged over the
        components; r_n, the reference error, says what is large for it on normal runs (the paper takes its mean). The
        ratio (dimensionless) is our reading of the equation: with the difference in scaled units, beta = 30 leaves
        alpha near 0.5 for ever.

        .. pydrake_system::

            name: RecallDetector
            input_ports:
            - posture_history
            - recalled_postures
            - hidden_state
            output_ports:
            - errors
            - alpha

        Ports: see the module's docstring; errors (N + 1,): l_n / r_n; `hidden_state` is left unread.
        Direct feedthrough of both postures; scalar-convertible.

        Constructor: keywords posture_size (M); horizon (N); state_size (S); reference_errors (N + 1,), r_n > 0, scaled
        units squared; beta > 0; gamma; component_weights (M,) >= 0 of the components in the average (default: ones).
        """

        def _construct(
            self,
            *,
            posture_size: int,
            horizon: int,
            state_size: int,
            reference_errors: np.ndarray,
            beta: float,
            gamma: float,
            component_weights: np.ndarray | None = None,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            posture_history, recalled, _ = declare_detector_inputs(
                self, posture_size=posture_size, horizon=horizon, state_size=state_size
            )
            reference_errors = require_vector("reference_errors", reference_errors, horizon + 1, minimum=0.0)
            if np.any(reference_errors == 0.0):
                raise ValueError(
                    f"reference_errors is {reference_errors}; every component must be greater than 0, errors are divided by "
                    "them: calibrate on runs in which the arm moves."
                )
            if component_weights is None:
                component_weights = np.ones(posture_size)
            weights = require_vector("component_weights", component_weights, posture_size, minimum=0.0)
            if not np.any(weights):
                raise ValueError(f"component_weights is {weights}; no component would count: weight at least one.")
            self._arguments = dict(
                posture_size=posture_size,
                horizon=horizon,
                state_size=state_size,
                reference_errors=reference_errors,
                beta=require_positive("beta", beta),
                gamma=float(require_vector("gamma", [gamma], 1)[0]),
                component_weights=weights,
            )
            # errors = factors * squares summed over the components, one row a tick.
            self._factors = weights / weights.sum() / reference_errors[:, None]
            self._shape = (horizon + 1, posture_size)
            self._beta, self._gamma = self._arguments["beta"], self._arguments["gamma"]
            self._posture_history, self._recalled = posture_history, recalled
            prerequisites = {posture_history.ticket(), recalled.ticket()}
            self._errors = self.DeclareVectorOutputPort("errors", horizon + 1, self._calc_errors, prerequisites)
            self.DeclareVectorOutputPort("alpha", 1, self._calc_alpha, prerequisites)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, **other._arguments, converter=converter)

        def _calc_errors(self, context, output):
            difference = self._posture_history.Eval(context) - self._recalled.Eval(context)
            output.SetFromVector(((difference * difference).reshape(self._shape) * self._factors).sum(axis=1))

        def _calc_alpha(self, context, output):
            output[0] = maximum(sigmoid(self._beta * (self._errors.Eval(context) - self._gamma)))

    return Impl


RecallDetector = RecallDetector_[None]
