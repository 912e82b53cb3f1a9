"""The Lyapunov function of mode `return`: the gauge of the box of joint limits about the initial posture."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, LIMIT_MARGIN
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from models.errors import InputError
from systems.posture_regulator import lqr

# Within so much of home a joint counts as there: the weight of a held can, which the servo does not know, holds joint 6
# off by half a degree.
CORE = HOME_TOLERANCE / 3.0


def scalar_gain(K: np.ndarray) -> float:
    """k of the gain K = k I (n, n) of dm = -K d a tick: with such a gain the joints are n loops that do not meet.

    Raises InputError for any other K, and for a k that is not between 0 and 1.
    """
    k = float(K[0, 0])
    if not np.allclose(K, k * np.eye(len(K)), atol=1e-9) or not 0.0 < k < 1.0:
        raise InputError(
            f"the regulator's gain has the diagonal {np.diag(K).round(4).tolist()}, and is certified as a multiple of "
            "the identity between 0 and 1 only: give world.regulator numbers as weights"
        )
    return k


@dataclass(frozen=True)
class BoxGauge:
    """V(d) = max_j max((d_j - core) / (up_j - core), (-d_j - core) / (down_j - core), 0) of the deviation d (7, rad).

    With the core 0 it is the gauge of the box -down <= d <= up about the initial posture; so V is 1 on its border, and
    0 where every joint is within the core. Its sublevel sets are boxes. Each joint goes home for itself, by -k d_j a
    tick and at most max_step_j: |d_j| shrinks by max(1 - k, 1 - max_step_j / |d_j|), and V at least by the largest of
    these; in the first tick from rest with first_step_j in the place of max_step_j, see `first_rate`. So the ideal
    loop leaves no sublevel set.
    """

    down: np.ndarray  # (7,) rad, > core: reach below the initial posture
    up: np.ndarray  # (7,) rad, > core: above
    gain: float  # k, a tick
    max_step: np.ndarray  # (7,) rad a tick
    first_step: np.ndarray  # (7,) rad, in the first tick from rest: what AccelerationLimit leaves of it
    core: float = CORE  # rad

    @classmethod
    def of(cls, world: World) -> Self:
        """The box of joint limits less LIMIT_MARGIN, and the loop of `world`.

        Raises InputError where the initial posture is not well within them, and as `scalar_gain` does.
        """
        lower, upper, speed = (v[:ARM_JOINTS] for v in controller_limits(PickPlaceStation(world, camera=False)))
        home, weights = world.initial_posture[:ARM_JOINTS], world.regulator
        K, _ = lqr(ARM_JOINTS, weights.state_weight, weights.input_weight, world.timing.period)
        down, up = home - lower - LIMIT_MARGIN, upper - LIMIT_MARGIN - home
        if min(down.min(), up.min()) <= HOME_TOLERANCE:
            nearest = np.rad2deg(LIMIT_MARGIN + HOME_TOLERANCE)
            raise InputError(
                f"world.initial_joints_deg {world.initial_joints_deg} is within {nearest:g} deg of a joint limit: "
                "choose a posture farther from them"
            )
        period = world.timing.period
        max_step = speed * period
        first_step = np.minimum(max_step, weights.acceleration * period**2)
        return cls(down, up, scalar_gain(K), max_step, first_step)

    def value(self, deviation: np.ndarray) -> np.ndarray:
        """V of deviations (..., 7), rad: (...)."""
        above = (deviation - self.core) / (self.up - self.core)
        below = (-deviation - self.core) / (self.down - self.core)
        return np.maximum(np.max(np.maximum(above, below), axis=-1), 0.0)

    def level_within(self, bound: float) -> float:
        """Largest level of V on which every |d_j| <= `bound`, rad, >= core."""
        return float((bound - self.core) / (np.maximum(self.up, self.down).max() - self.core))

    @property
    def ideal_rate(self) -> float:
        """V[k+1] <= rate V[k] in the ideal loop, on the whole box, where AccelerationLimit cuts nothing."""
        return float(np.max(np.maximum(1.0 - self.gain, 1.0 - self.max_step / np.maximum(self.up, self.down))))

    @property
    def farthest_first_rate(self) -> float:
        """`first_rate` from anywhere in the box, at most."""
        reach = np.maximum(self.up, self.down)
        return float(np.max(np.maximum(1.0 - self.gain, 1.0 - self.first_step / reach)))

    def first_rate(self, deviation: np.ndarray) -> np.ndarray:
        """V[1] <= rate V[0] in the ideal loop from rest at deviations (..., 7), rad: (...), 1 - k or more."""
        step = np.clip(self.gain * deviation, -self.first_step, self.first_step)
        value = self.value(deviation)
        ratio = self.value(deviation - step) / np.where(value > 0.0, value, np.inf)
        return np.maximum(1.0 - self.gain, ratio)

    def sample(self, rng: np.random.Generator) -> np.ndarray:
        """(7,) a deviation, rad, uniform in the box."""
        return rng.uniform(-self.down, self.up)

    def to_border(self, deviation: np.ndarray) -> np.ndarray:
        """`deviation` (7,), rad, not 0, times what brings it onto the border of the box."""
        return deviation / np.max(np.maximum(deviation / self.up, -deviation / self.down))
