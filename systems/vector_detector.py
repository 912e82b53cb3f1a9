"""What detectors have in common that judge one vector a tick: the hidden state, and what else goes with it."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.detector import CalibratedDetector

SPREAD = 1e-3  # least standard deviation that a component is divided by


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


def standard_of(rows: np.ndarray) -> dict[str, np.ndarray]:
    """mean and spread (D,) of rows (n, D), float32; no spread below SPREAD."""
    mean, spread = rows.mean(axis=0), np.maximum(rows.std(axis=0), SPREAD)
    return {"mean": mean.astype(np.float32), "spread": spread.astype(np.float32)}


def standard(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Of what `standard_of` gave, float64; raises ValueError where it is not there, or a spread is not above 0."""
    if not {"mean", "spread"} <= set(arrays) or not np.all(arrays["spread"] > 0.0):
        raise ValueError("there is no mean, or no spread above 0: fit again.")
    return np.asarray(arrays["mean"], float), np.asarray(arrays["spread"], float)
