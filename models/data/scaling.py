"""Affine scaling of each component to about [-1, 1]."""

from dataclasses import dataclass
from typing import Self

import numpy as np


@dataclass(frozen=True)
class MinMaxScaling:
    """Maps lower (n,) to -1 and upper (n,) to +1, component by component; same units in and out as the data's."""

    lower: np.ndarray
    upper: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", np.asarray(self.lower, float))
        object.__setattr__(self, "upper", np.asarray(self.upper, float))
        if self.lower.ndim != 1 or self.lower.shape != self.upper.shape or not np.all(self.upper > self.lower):
            raise ValueError("MinMaxScaling needs lower < upper, two vectors of one length")

    @classmethod
    def from_data(cls, x: np.ndarray, margin: float = 1.1, minimum_half_range: float | np.ndarray = 1e-3) -> Self:
        """Bounds of x (T, n), their half range made `margin` times wider and no smaller than minimum_half_range."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        half = np.maximum(0.5 * margin * (high - low), minimum_half_range)
        return cls(0.5 * (low + high) - half, 0.5 * (low + high) + half)

    @property
    def centre(self) -> np.ndarray:
        """Middle of the bounds (n,)."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half_range(self) -> np.ndarray:
        """Half of the bounds' distance (n,): one scaled unit."""
        return 0.5 * (self.upper - self.lower)

    def scale(self, x: np.ndarray) -> np.ndarray:
        """Physical (..., n) to scaled."""
        return (x - self.centre) / self.half_range

    def unscale(self, x: np.ndarray) -> np.ndarray:
        """Scaled (..., n) to physical."""
        return x * self.half_range + self.centre
