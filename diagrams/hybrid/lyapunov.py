"""The Lyapunov function of mode `return`: the Riccati matrix of the LQR on the posture integrator (Sec. III-D)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from systems.posture_regulator import lqr

SAFETY_FACTOR = 1.5  # on the measured tracking error


@dataclass(frozen=True)
class Lyapunov:
    """V = d' P d of the deviation d (7, rad) from the initial posture; the LQR's step is -K d a tick."""

    P: np.ndarray  # (7, 7) rad^-2
    gain: np.ndarray  # K (7, 7)
    rate: float  # V[k+1] <= rate V[k] in the ideal loop

    @classmethod
    def of(cls, world: World, units: np.ndarray) -> Self:
        """From the Riccati equation, the regulator's weights in `units` (7, rad); the gain does not depend on them."""
        weight = np.diag(1.0 / np.asarray(units) ** 2)
        Q, R = world.regulator.state_weight * weight, world.regulator.input_weight * weight
        K, S = lqr(ARM_JOINTS, Q, R, world.timing.period)
        # V falls by d'(Q + K'RK)d a tick.
        root = np.linalg.inv(np.linalg.cholesky(S))
        fall = np.linalg.eigvalsh(root @ (Q + K.T @ R @ K) @ root.T)[0]
        return cls(S, K, float(1.0 - fall))

    def value(self, deviation: np.ndarray) -> np.ndarray:
        """V of deviations (..., 7), rad."""
        return np.einsum("...i,ij,...j->...", deviation, self.P, deviation)

    def level_within(self, rows: np.ndarray, bounds: np.ndarray) -> float:
        """Largest level on which |rows d| <= bounds for `rows` (n, 7) and `bounds` (n,)."""
        reach = np.einsum("ni,ij,nj->n", rows, np.linalg.inv(self.P), rows)
        return float(np.min(np.asarray(bounds) ** 2 / reach))

    def relative_error(self, rows: np.ndarray, home: np.ndarray) -> np.ndarray:
        """(n - 1,) the servo's error over the step it was given, in V's norm, along the joint angles `rows` (n, 7)."""
        deviation = rows - home
        step = -deviation[:-1] @ self.gain.T
        return np.sqrt(self.value(deviation[1:] - deviation[:-1] - step) / self.value(step))

    def rate_with(self, eta: float) -> float:
        """Contraction of V a tick with a relative tracking error of at most `eta`."""
        root = np.linalg.cholesky(self.P)
        largest = np.linalg.norm(root.T @ self.gain @ np.linalg.inv(root.T), 2)
        return float((np.sqrt(self.rate) + eta * largest) ** 2)

    def servo_level(self, starts: Sequence[float], etas: Sequence[float]) -> float:
        """Level below which the loop contracted with every tracking error measured, enlarged by the safety factor.

        `starts`: V of the postures; `etas`: their largest relative tracking errors. Infinite where all of them leave it
        contracting.
        """
        too_far = [v for v, eta in zip(starts, etas, strict=True) if self.rate_with(SAFETY_FACTOR * eta) >= 1.0]
        return float(min(too_far, default=np.inf))

    def sample_inside(self, rng: np.random.Generator, level: float, count: int) -> np.ndarray:
        """(count, 7) deviations, rad, uniform in the level set."""
        direction = rng.normal(size=(count, ARM_JOINTS))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        radius = np.sqrt(level) * rng.uniform(size=(count, 1)) ** (1 / ARM_JOINTS)
        return np.linalg.solve(np.linalg.cholesky(self.P).T, (radius * direction).T).T
