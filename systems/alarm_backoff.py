"""An alarm that comes again after it was answered: what the next one must reach."""

from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive, require_vector
from systems.detector import GUARD, NEVER, alpha_of

PATIENCE = 8.0  # s: a return after disturbance A takes up to 7
MOST = 2  # returns that are counted: an arm that is moved away is noticed however many there were


class AlarmBackoff(LeafSystem):
    """Each return makes the next one ask for `factor` times the error: gamma factor^n instead of gamma.

    A return mends what has passed. A fault that stays is there again after it, or keeps the detector's alpha high at
    home: there another return is worth nothing, and the task that the network alone would have done is lost. So, as a
    sender that gets no answer waits longer each time (exponential backoff), the arm returns once more only for an error
    that is much larger.

    n counts the returns, and each PATIENCE seconds of one that is not over, up to MOST. Where n is 0, alpha is the
    detector's, to the bit. Else a return begins where the error reaches the raised gamma. It is over with the
    detector's alpha; or, where the error has fallen below the raised gamma alone, it is given up: the network starts
    anew, and has the arm in the next tick, if the error of its new recall too is below that, as it is near home. (A
    detector whose memory starts anew with the network says nothing in that tick: there it has the arm wherever that
    is.) n is 0 again once the detector has had no alarm for PATIENCE seconds, while the network had the arm: under a
    fault that stays, never. Then what is smaller than gamma factor^MOST goes unnoticed, such as an arm that is only
    stopped.

    .. pydrake_system::

        name: AlarmBackoff
        input_ports: [alpha, errors]
        output_ports: [answered_alpha, given_up]

    Inputs: of the detector, see systems/detector.py; read at the ticks too.
        alpha: (1,) alpha_k in [0, 1].
        errors: (E,) from which it comes, each divided by its mean on normal runs.
    Outputs:
        answered_alpha: (1,) in the place of alpha_k: alpha_k; but an alarm with which a return would begin, or that is
            there after one was given up, is no more than Eqs. 5 and 6 make of the errors and gamma factor^n.
        given_up: (1,) 1 in the tick in which a return is given up, else 0: the network starts anew.
        Direct feedthrough of both inputs. A count has no derivative: no AutoDiff.

    Numeric parameters of the Context: beta, gamma; 1 and NEVER in a default one. Discrete state: n; ticks of the
    return under way; whether it was given up in the tick before; ticks since the detector's last alarm.
    """

    def __init__(self, *, criteria: int, factor: float, period: float):
        """
        Args:
            criteria: E.
            factor: above 1, at most 1e6, dimensionless.
            period: of the ticks, s.
        """
        super().__init__()
        self._factor = require_positive("factor", factor)
        if not 1.0 < self._factor <= 1e6:
            raise ValueError(f"factor is {factor}; each return raises gamma by it: pass a number above 1, at most 1e6.")
        period = require_positive("period", period)
        self._patience = require_count("PATIENCE in ticks", max(round(PATIENCE / period), 1))
        self._beta, self._gamma = (self.DeclareNumericParameter(BasicVector([value])) for value in (1.0, NEVER))
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._errors = self.DeclareVectorInputPort("errors", require_count("criteria", criteria))
        state = self.DeclareDiscreteState(4)
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket(), self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort("answered_alpha", 1, self._calc_alpha, reads)
        self.DeclareVectorOutputPort("given_up", 1, self._calc_given_up, reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def set_calibration(self, context: Context, beta: float, gamma: float) -> None:
        """Sets the detector's `beta` and `gamma`, see CalibratedDetector, in this system's `context`."""
        values = [require_positive("beta", beta)], require_vector("gamma", [gamma], 1)
        for index, value in zip((self._beta, self._gamma), values, strict=True):
            context.get_mutable_numeric_parameter(index).SetFromVector(value)

    def _raised(self, context: Context) -> float:
        """The detector's alpha; where that is an alarm, no more than by the raised gamma."""
        alpha, answers = self._alpha.Eval(context)[0], context.get_discrete_state_vector()[0]
        if not answers or alpha < GUARD:
            return alpha
        beta, gamma = (context.get_numeric_parameter(index)[0] for index in (self._beta, self._gamma))
        return min(alpha, alpha_of(self._errors.Eval(context), beta, gamma * self._factor**answers))

    def _answered(self, context: Context) -> float:
        _, ticks, anew, _ = context.get_discrete_state_vector().value()
        return self._alpha.Eval(context)[0] if ticks and not anew else self._raised(context)

    def _given_up(self, context: Context) -> bool:
        _, ticks, anew, _ = context.get_discrete_state_vector().value()
        return bool(ticks and not anew and self._alpha.Eval(context)[0] >= GUARD > self._raised(context))

    def _calc_alpha(self, context: Context, output: BasicVector) -> None:
        output[0] = self._answered(context)

    def _calc_given_up(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._given_up(context))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        answers, ticks, _, quiet = context.get_discrete_state_vector().value()
        if self._answered(context) >= GUARD:
            ticks, quiet = ticks + 1.0, 0.0
            counts = ticks % self._patience == 0.0
        else:
            counts, ticks = ticks > 0.0, 0.0
            quiet = quiet + 1.0 if self._alpha.Eval(context)[0] < GUARD else 0.0
        if counts:
            answers = min(answers + 1.0, MOST)
        if quiet >= self._patience:
            answers, quiet = 0.0, self._patience
        discrete_state.set_value([answers, ticks, float(self._given_up(context)), quiet])
