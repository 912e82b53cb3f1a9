"""What detectors have in common that judge one vector a tick: the hidden state, and what else goes with it."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.detector import CalibratedDetector


class VectorDetector(CalibratedDetector, LeafSystem):
    """One criterion, l = how anomalous the values of some input ports are, side by side, by a subclass's `anomaly`.

    Ports: see systems/detector.py; errors (1,): l / mean_l. Direct feedthrough of the ports in `reads`; no state.

    A subclass has `reads`, the names of these ports; its `fit` takes the same rows from models.data.runs.rows_of.
    """

    learns_from = "network"
    reads: tuple[str, ...] = ("hidden_state",)

    def __init__(self, policy):
        """`policy`: see `declare_detector_inputs`."""
        super().__init__()
        self.declare_ports(policy, criteria=1, reads=self.reads)
        self._ports = [self.GetInputPort(name) for name in self.reads]

    def require_width(self, width: int) -> None:
        """Raises ValueError unless the ports that are read have so many components."""
        if (sizes := sum(port.size() for port in self._ports)) != width:
            raise ValueError(f"what was fitted has {width} components, {' and '.join(self.reads)} {sizes}: fit again.")

    def anomaly(self, rows: np.ndarray) -> np.ndarray:
        """(n,) >= 0, of rows (n, D)."""
        raise NotImplementedError

    def calc_errors(self, context, mean_errors):
        row = np.concatenate([port.Eval(context) for port in self._ports])
        return self.anomaly(row[None]) / mean_errors
