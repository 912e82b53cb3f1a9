"""The recurrent network with its recall heads as a discrete-time system (Secs. III-B and III-C)."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem
from pydrake.systems.sensors import ImageRgba8U

from systems.arguments import require_count, require_positive, require_vector
from systems.image_encoder import encoded_picture


class RecurrentPolicy(LeafSystem):
    """Steps the network once a tick; hidden state, prediction and recall are discrete state.

    .. pydrake_system::

        name: RecurrentPolicy
        input_ports: [network_input, reset]  # and rgb_image, for a policy that looks itself; memory, where told so
        output_ports: [predicted_posture, predicted_features, recalled_postures, hidden_state]

    Inputs:
        network_input: (M + F,) the scaled posture and the image features, x_k of Eqs. 7 and 8; dimensionless.
        reset: (1,) above 1/2: the update does not step the network but takes c_0, and predicts the initial posture;
            what is recalled moves on by a row, as in a network that rests there. So all that was recalled before is
            gone after N + 1 such ticks, not at once. Left unconnected, there is no reset.
        rgb_image: ImageRgba8U, square, at least 112 pixels wide; read at the ticks only.
        memory: (1 + S + (N + 1) M + F,) where the first is above 1/2, the update takes the others for what the outputs
            hidden_state, recalled_postures and predicted_features are, and does nothing else.
    Outputs (of the state alone, none has direct feedthrough; after the update of tick k):
        predicted_posture: (M,) m^R_{k+1}, scaled, clipped to [-1, 1].
        predicted_features: (F,) f^R_{k+1}, clipped to [-1, 1].
        recalled_postures: ((N + 1) M,) scaled, row by row: row 0 is m^R_{k+1}, predicted, row n is m^R_{k-n},
            recalled from c_k. What the detector reads at tick k + 1. Of a policy that recalls nothing, row n is what
            it predicted for tick k + 1 - n.
        hidden_state: (S,) c_k, dimensionless.

    Before the first tick: c_0; the initial posture, where the arm rests, as prediction and as all that is recalled;
    features 0.
    """

    def __init__(self, policy, period: float = 0.1, rewinds: bool = False):
        """
        Args:
            policy: any object with `posture_size` M, `feature_size` F, `state_size` S, `horizon` N, `initial_state`
                (S,), `initial_posture` (M,) physical, `scaling.scale` and `step(x, state) -> (y, state, recalled)`;
                see models/inference.py and models/policy.py. S may be 0; `looks`, if it is there and true: `step`
                takes the picture too; `recalls`, if it is there and false: `step` recalls None.
            period: of the ticks, s.
            rewinds: with the input `memory`.
        """
        super().__init__()
        self._policy = policy
        self._posture_size = require_count("policy.posture_size", policy.posture_size)
        self._feature_size = require_count("policy.feature_size", policy.feature_size)
        state_size = require_count("policy.state_size", policy.state_size, 0)
        self._horizon = require_count("policy.horizon", policy.horizon)
        initial_state = require_vector("policy.initial_state", policy.initial_state, state_size)
        initial_posture = require_vector("policy.initial_posture", policy.initial_posture, self._posture_size)
        posture = np.clip(policy.scaling.scale(initial_posture), -1.0, 1.0)

        self._network_input = self.DeclareVectorInputPort("network_input", self._posture_size + self._feature_size)
        self._reset = self.DeclareVectorInputPort("reset", 1)
        self._image = None
        if getattr(policy, "looks", False):
            any_size = AbstractValue.Make(ImageRgba8U(1, 1))
            self._image = self.DeclareAbstractInputPort("rgb_image", any_size)
        self._initial = np.zeros(self._feature_size), posture, initial_state
        self._predicted_features = self.DeclareDiscreteState(self._initial[0])
        self._recalled = self.DeclareDiscreteState(np.tile(posture, self._horizon + 1))
        self._hidden = self.DeclareDiscreteState(initial_state)
        self._memory = None
        if rewinds:
            size = state_size + len(posture) * (self._horizon + 1) + self._feature_size
            self._memory = self.DeclareVectorInputPort("memory", 1 + size)
        of_recall = {self.discrete_state_ticket(self._recalled)}
        self.DeclareVectorOutputPort("predicted_posture", self._posture_size, self._calc_prediction, of_recall)
        self.DeclareStateOutputPort("predicted_features", self._predicted_features)
        self.DeclareStateOutputPort("recalled_postures", self._recalled)
        self.DeclareStateOutputPort("hidden_state", self._hidden)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def set_memory(self, context: Context, hidden: np.ndarray, predicted: np.ndarray, recalled: np.ndarray) -> None:
        """Puts the network into another state, in this system's `context`.

        `hidden` (S,) c_k; `predicted` (M + F,) of tick k+1, clipped; `recalled` (N, M); all scaled.
        """
        context.SetDiscreteState(self._hidden, hidden)
        context.SetDiscreteState(self._recalled, np.concatenate((predicted[: self._posture_size], np.ravel(recalled))))
        context.SetDiscreteState(self._predicted_features, predicted[self._posture_size :])

    def _calc_prediction(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._recalled).value()[: self._posture_size])

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self._memory is not None and (memory := self._memory.Eval(context))[0] > 0.5:
            groups = self._hidden, self._recalled, self._predicted_features
            sizes = [context.get_discrete_state(group).size() for group in groups]
            for group, values in zip(groups, np.split(memory[1:], np.cumsum(sizes)[:-1]), strict=True):
                discrete_state.set_value(group, values)
            return
        if self._reset.HasValue(context) and self._reset.Eval(context)[0] > 0.5:
            features, posture, hidden = self._initial
            before = context.get_discrete_state(self._recalled).value()
            discrete_state.set_value(self._recalled, np.concatenate((posture, before[: -self._posture_size])))
            discrete_state.set_value(self._predicted_features, features)
            discrete_state.set_value(self._hidden, hidden)
            return
        x = self._network_input.Eval(context)
        picture = () if self._image is None else (encoded_picture(self._image.Eval(context)),)
        y, hidden, recalled = self._policy.step(x, context.get_discrete_state(self._hidden).value().copy(), *picture)
        if recalled is None and not getattr(self._policy, "recalls", True):
            before = context.get_discrete_state(self._recalled).value()
            recalled = before[: -self._posture_size].reshape(self._horizon, self._posture_size)
        if np.shape(recalled) != (self._horizon, self._posture_size):
            raise ValueError(
                f"policy.step recalled shape {np.shape(recalled)}; its horizon and posture_size ask for "
                f"{(self._horizon, self._posture_size)}: use the weight file and the code of one version."
            )
        if not (np.isfinite(y).all() and np.isfinite(hidden).all() and np.isfinite(recalled).all()):
            raise ValueError(
                f"The network's output at t = {context.get_time():g} s has values that are not finite (its input, at "
                f"most {np.max(np.abs(x)):g} in magnitude, should be near [-1, 1]): check the weights and the scaling."
            )
        y = np.clip(y, -1.0, 1.0)
        discrete_state.set_value(self._recalled, np.concatenate((y[: self._posture_size], np.ravel(recalled))))
        discrete_state.set_value(self._predicted_features, y[self._posture_size :])
        discrete_state.set_value(self._hidden, hidden)
