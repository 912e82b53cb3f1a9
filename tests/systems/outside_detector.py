"""A detector as somebody else would write it: how far the second joint is."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.detector import CalibratedDetector


class FarFromHome(CalibratedDetector, LeafSystem):
    """l = |m_2| / the largest seen in the runs; scaled."""

    name = "far"

    def __init__(self, policy, largest=1.0):
        LeafSystem.__init__(self)
        self._largest = largest
        self.declare_ports(policy, criteria=1, reads=("posture_history",))

    @staticmethod
    def fit(runs):
        return {"largest": np.array([max(np.abs(run[:, 1]).max() for run in runs)])}

    @staticmethod
    def build(policy, joints, arrays):
        return FarFromHome(policy, float(arrays["largest"][0]))

    def calc_errors(self, context, mean_errors):
        return np.abs(self.posture_history.Eval(context)[1:2]) / self._largest / mean_errors
