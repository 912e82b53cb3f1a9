"""Loop closing (Eqs. 7 and 8): while the arm is off its learned trajectory, the network is fed its own predictions."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count


@TemplateSystem.define("LoopCloser_", T_list=[float, AutoDiffXd])
def LoopCloser_(T):
    class Impl(LeafSystem_[T]):
        """x_k = (1 - alpha_k) [m_k, f_k] + alpha_k [m^R_k, f^R_k], Eqs. 7 and 8.

        .. pydrake_system::

            name: LoopCloser
            input_ports: [posture, features, predicted_posture, predicted_features, alpha]
            output_ports: [network_input]

        Inputs (all scaled, dimensionless):
            posture: (M,) m_k, measured.
            features: (F,) f_k, of the image.
            predicted_posture: (M,) m^R_k, predicted at the tick before.
            predicted_features: (F,) f^R_k, predicted at the tick before.
            alpha: (1,) alpha_k in [0, 1], known before the network steps.
        Outputs:
            network_input: (M + F,) x_k. Direct feedthrough of every input; converts to AutoDiffXd.

        Where alpha is exactly 1, what is measured is not evaluated: no picture is taken and encoded for nothing.

        Constructor: keywords posture_size (M), feature_size (F).
        """

        def _construct(self, *, posture_size: int, feature_size: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self._sizes = dict(
                posture_size=require_count("posture_size", posture_size),
                feature_size=require_count("feature_size", feature_size),
            )
            self._posture = self.DeclareVectorInputPort("posture", posture_size)
            self._features = self.DeclareVectorInputPort("features", feature_size)
            self._predicted_posture = self.DeclareVectorInputPort("predicted_posture", posture_size)
            self._predicted_features = self.DeclareVectorInputPort("predicted_features", feature_size)
            self._alpha = self.DeclareVectorInputPort("alpha", 1)
            self.DeclareVectorOutputPort(
                "network_input", posture_size + feature_size, self._calc, {self.all_input_ports_ticket()}
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, **other._sizes, converter=converter)

        def _calc(self, context, output):
            alpha = self._alpha.Eval(context)[0]
            x = np.concatenate((self._predicted_posture.Eval(context), self._predicted_features.Eval(context)))
            if T is not float or alpha != 1.0:  # a derivative by alpha needs both
                measured = np.concatenate((self._posture.Eval(context), self._features.Eval(context)))
                x = (1.0 - alpha) * measured + alpha * x
            output.SetFromVector(x)

    return Impl


LoopCloser = LoopCloser_[None]
