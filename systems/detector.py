"""Detection of the unlearned situation: what a detector is, and what all of ours share (Eqs. 5 and 6).

A detector is any system with these ports, so that another one takes its place without another change:

    Inputs:
        posture_history: ((N + 2) M,) scaled m_k (measured now), m_{k-1}, ..., m_{k-1-N}, row by row.
        recalled_postures: ((N + 1) M,) scaled, of the state before the tick's update: row 0 is m^R_k, predicted at
            k - 1, row n is the m^R_{k-1-n} that c_{k-1} recalls, n = 1 .. N.
        hidden_state: (S,) c_{k-1} of the network.
    Further inputs, each only where a detector declares it; the controller connects what is there:
        features: (F,) f_k of the picture. Then a picture is taken at every tick, also where alpha is 1.
        predicted_features: (F,) f^R_k, predicted at k - 1; all exactly 0 where nothing was predicted: before the first
            tick, and where the network started anew.
        active: (1,) 1 while the arm is known to be disturbed, or the fault to act, else 0: true of the tick before.
        network_input: (M + F,) x_k, what the network is fed; reset: (1,) above 1/2: it starts anew instead. Both come
            from alpha_k: the detector's update may read them, its outputs not.
    Outputs:
        errors: (E,) what alpha comes from, one number a criterion (E is the detector's choice), each divided by its
            mean on normal runs.
        alpha: (1,) alpha_k in [0, 1]; 0 on the learned trajectory, 1 off it. Read by the updates of tick k: known
            before the network steps.

`declare_detector_inputs` declares the inputs; one that a detector doesn't need is left unread. A memory, if it needs
one, belongs in its Context as discrete state with the tick's period. Its class, which `systems.detectors.DETECTORS`
finds by a name or as `package.module:Class`, offers beside the ports:

    name: str, a short one.
    learns_from: str, what `fit` is given; "postures" where there is no such attribute: see models/data/runs.py.
    has_gamma: bool, whether alpha comes from errors by a gamma; True where there is no such attribute.
    fit(runs) -> arrays: static; what it learns from runs (T_i, J), rad, as a file keeps it: numpy arrays by name.
    build(policy, joints, arrays) -> System: static; judges the first `joints` components, and never fires yet.
        `policy`: see models/inference.py; `arrays`: of `fit`.
    set_calibration(context, mean_errors, beta, gamma): of one Context; see CalibratedDetector, which has it.
"""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector_, Context, System

from systems.arguments import require_count, require_positive, require_vector

GUARD = 0.5  # alpha below it: the network has the arm
NEVER = 1e12  # a gamma that no error reaches
PERIOD = 0.1  # s, of the ticks, where a policy says no other
FURTHER = ("features", "predicted_features", "active", "network_input", "reset")  # inputs that a detector may have
EXPONENT = 500.0  # exp(500) is finite; 1 / (1 + exp(500)) is 0 to every purpose


def alpha_of(errors: np.ndarray, beta, gamma):
    """max_n 1 / (1 + exp(-beta (e_n - gamma))), Eqs. 5 and 6, of `errors` (E,), float or AutoDiffXd; no overflow."""
    x = (beta * (errors - gamma)).max()  # the sigmoid rises: the largest argument gives the largest value
    limit = type(x)(EXPONENT)
    return 1.0 / (1.0 + np.exp(-min(max(x, -limit), limit)))


def _input_sizes(policy) -> dict[str, int]:
    """Of the inputs that every detector has."""
    horizon = require_count("policy.horizon", policy.horizon)
    size = require_count("policy.posture_size", policy.posture_size)
    state_size = require_count("policy.state_size", policy.state_size, 0)
    return dict(
        posture_history=(horizon + 2) * size, recalled_postures=(horizon + 1) * size, hidden_state=state_size
    )  # fmt: skip


def _further_sizes(policy) -> dict[str, int]:
    """Of those that some have."""
    features = require_count("policy.feature_size", getattr(policy, "feature_size", 1))
    size = require_count("policy.posture_size", policy.posture_size)
    return dict(features=features, predicted_features=features, active=1, network_input=size + features, reset=1)


def declare_detector_inputs(system, policy, *further: str) -> tuple:
    """Declares a detector's three input ports on `system`, and `further` ones, of FURTHER; returns them in that order.

    `policy`: any object with `posture_size` M, `horizon` N, `state_size` S, and `feature_size` F for further ones.
    """
    sizes, more = _input_sizes(policy), _further_sizes(policy)
    sizes |= {name: more[name] for name in FURTHER if name in further}
    return tuple(system.DeclareVectorInputPort(name, size) for name, size in sizes.items())


def period_of(policy) -> float:
    """The period, s, of the ticks that `policy` was trained with: of what a detector remembers from tick to tick."""
    world = getattr(policy, "metadata", {}).get("world", {})
    return require_positive("the period of the policy", float(np.asarray(world.get("period", PERIOD))))


def check_detector(system: System, policy) -> None:
    """Raises ValueError unless `system` has a detector's ports with the policy's sizes, and `set_calibration`."""
    kind = type(system).__name__
    ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
    ports += [system.get_output_port(i) for i in range(system.num_output_ports())]
    have = {port.get_name(): port.size() for port in ports}
    sizes = {name: size for name, size in _further_sizes(policy).items() if name in have}
    for name, size in (_input_sizes(policy) | sizes | {"errors": None, "alpha": 1}).items():
        if name not in have:
            raise ValueError(f"{kind} has no port `{name}`: declare the ports that systems/detector.py lists.")
        if size is not None and have[name] != size:
            raise ValueError(
                f"The port `{name}` of {kind} has size {have[name]}, the policy asks for {size}: build it for that."
            )
    if not hasattr(system, "set_calibration"):
        raise ValueError(f"{kind} has no method `set_calibration`: derive it from CalibratedDetector, or write one.")


class CalibratedDetector:
    """alpha = max_n 1 / (1 + exp(-beta (l_n / mean_l_n - gamma))) over E criteria; a subclass says what l_n is.

    A mixin: `class Mine(CalibratedDetector, LeafSystem)`. The subclass calls `declare_ports` in its constructor and
    defines `calc_errors`.

    mean_l_n is the mean of l_n on normal runs. The ratio (dimensionless) is our reading of the equation: with the
    difference in scaled units, beta = 30 leaves alpha near 0.5 for ever.

    Numeric parameters of the Context: mean_errors (E,), beta (1,), gamma (1,). In a default Context they are 1, 1
    and NEVER: nothing fires, and `errors` are the l_n themselves, from which any detector is calibrated. A clone of a
    Context has its values. A system converted to AutoDiffXd starts from the default ones:
    `converted_context.SetTimeStateAndParametersFrom(context)` brings those of a Context.
    """

    learns_from = "postures"

    @staticmethod
    def fit(runs: list) -> dict[str, np.ndarray]:
        """What is learned from `runs`: nothing."""
        return {}

    def declare_ports(
        self: Any,
        policy,
        *,
        criteria: int,
        reads: tuple[str, ...],
        updates_read: tuple[str, ...] = (),
        remembers: bool = False,
        scalar: type = float,
    ) -> None:
        """Declares a detector's ports, and its parameters; each input is an attribute of its name from then on.

        Args:
            policy: see `declare_detector_inputs`.
            criteria: E.
            reads: names of the inputs that `calc_errors` reads; those of FURTHER are declared.
            updates_read: of FURTHER, those that only the update reads; declared too.
            remembers: whether `calc_errors` reads the discrete state.
            scalar: of the system: float or AutoDiffXd.
        """
        further = [name for name in FURTHER if name in (*reads, *updates_read)]
        ports = declare_detector_inputs(self, policy, *further)
        self.posture_history, self.recalled_postures, self.hidden_state = ports[:3]
        for name, port in zip(further, ports[3:], strict=True):
            setattr(self, name, port)
        self._means, self._beta, self._gamma = (
            self.DeclareNumericParameter(BasicVector_[scalar]([scalar(value)] * size))
            for value, size in ((1.0, criteria), (1.0, 1), (NEVER, 1))
        )
        prerequisites = {self.GetInputPort(name).ticket() for name in reads} | {self.all_parameters_ticket()}
        if remembers:
            prerequisites.add(self.xd_ticket())
        self._errors = self.DeclareVectorOutputPort("errors", criteria, self._write_errors, prerequisites)
        self.DeclareVectorOutputPort("alpha", 1, self._write_alpha, prerequisites)

    def calc_errors(self, context: Context, mean_errors: np.ndarray) -> np.ndarray:
        """l_n / mean_l_n (E,), with `mean_errors` mean_l_n (E,)."""
        raise NotImplementedError

    def set_calibration(self, context: Context, mean_errors, beta: float, gamma: float) -> None:
        """Sets the parameters in `context`, this system's own, of floats; holds at once.

        Args:
            mean_errors: (E,) mean_l_n > 0, unit of l_n.
            beta: slope, > 0; gamma: what l_n / mean_l_n must reach for alpha = 1/2. Dimensionless.
        """
        size = context.get_numeric_parameter(self._means).size()
        means = require_vector("mean_errors", mean_errors, size, minimum=0.0)
        if np.any(means == 0.0):
            raise ValueError(
                f"mean_errors is {means}; every component must be greater than 0, errors are divided by it: "
                "calibrate on runs in which the arm moves."
            )
        values = means, [require_positive("beta", beta)], require_vector("gamma", [gamma], 1)
        for index, value in zip((self._means, self._beta, self._gamma), values, strict=True):
            context.get_mutable_numeric_parameter(index).SetFromVector(value)

    def _write_errors(self, context, output):
        output.SetFromVector(self.calc_errors(context, context.get_numeric_parameter(self._means).CopyToVector()))

    def _write_alpha(self, context, output):
        beta, gamma = (context.get_numeric_parameter(i)[0] for i in (self._beta, self._gamma))
        output[0] = alpha_of(self._errors.Eval(context), beta, gamma)
