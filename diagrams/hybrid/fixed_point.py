"""Fixed points of a map z -> F(z), and how fast a perturbation of one decays in simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

NEWTON_STEPS = 60
RESIDUAL = 1e-11  # largest component of F(z) - z at a fixed point
STARTS = (0, 1, 5, 20, 60, 200)  # ticks of the map before Newton begins
PERTURBATION = 1e-5  # norm
DECAY_TICKS = (60, 3000)  # at least and at most

Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class FixedPoint:
    """Where Newton's method ended: a fixed point, or a slow point, at which the motion is slowest."""

    z: np.ndarray
    residual: float  # largest component of F(z) - z

    @property
    def converged(self) -> bool:
        """Whether it is a fixed point."""
        return self.residual < RESIDUAL


def newton(step: Map, jacobian: Map, start: np.ndarray) -> FixedPoint:
    """Newton's method on F(z) - z = 0 with step halving; it ends where no step makes the residual smaller.

    `step`, `jacobian`: F and its derivative; `start`: z, (n,).
    """
    z = start
    residual = step(z) - z
    for _ in range(NEWTON_STEPS):
        if np.max(np.abs(residual)) < RESIDUAL:
            break
        direction = np.linalg.lstsq(jacobian(z) - np.eye(len(z)), -residual, rcond=None)[0]
        for share in 0.5 ** np.arange(12):
            candidate = z + share * direction
            after = step(candidate) - candidate
            if np.linalg.norm(after) < np.linalg.norm(residual):
                break
        else:
            break
        z, residual = candidate, after
    return FixedPoint(z, float(np.max(np.abs(residual))))


def nearest_fixed_point(step: Map, jacobian: Map, origin: np.ndarray, posture_size: int) -> FixedPoint:
    """The fixed point with the posture nearest to that of `origin`, of those found from the orbit that leaves it.

    `origin`: z, (n,), its last `posture_size` components the posture. The slowest slow point where there is no fixed
    one.
    """
    found, z = [], origin
    for k in range(STARTS[-1] + 1):
        if k in STARTS:
            found.append(newton(step, jacobian, z))
        z = step(z)
    fixed = [point for point in found if point.converged]
    if not fixed:
        return min(found, key=lambda point: point.residual)
    return min(fixed, key=lambda p: np.linalg.norm(p.z[-posture_size:] - origin[-posture_size:]))


def measure_decay(
    step: Map, point: np.ndarray, spectral_radius: float, rng: np.random.Generator
) -> tuple[float, np.ndarray]:
    """Simulates a small random perturbation of `point` (n,), which shrinks, or grows: factor a tick, norms (ticks,).

    The perturbed orbit is compared with the one from `point` itself. The factor is fitted by least squares to the
    logarithm of the norm over the second half of the ticks, when the slowest part is left alone; over as many ticks as
    double precision (or, growing, linearity) allows.
    """
    rate = max(abs(np.log(max(spectral_radius, 1e-6))), 1e-6)
    # Down from the perturbation to what rounding leaves of it, up to where it is no longer small.
    span = np.log(1e7) if spectral_radius < 1 else np.log(1e3)
    ticks = int(np.clip(span / rate, *DECAY_TICKS))
    direction = rng.normal(size=len(point))
    reference, orbit = point, point + PERTURBATION * direction / np.linalg.norm(direction)
    norms = [PERTURBATION]
    for _ in range(ticks):
        reference, orbit = step(reference), step(orbit)
        norms.append(float(np.linalg.norm(orbit - reference)))
        if not PERTURBATION * 1e-8 < norms[-1] < PERTURBATION * 1e4:
            break
    half = len(norms) // 2
    slope = np.polyfit(np.arange(half, len(norms)), np.log(np.maximum(norms[half:], 1e-300)), 1)[0]
    return float(np.exp(slope)), np.array(norms)
