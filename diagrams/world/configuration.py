"""What can be configured of the robot and its world: defaults here; a world file, a scenario or options over them.

Units: m, rad, s, N m unless a field's comment says otherwise; positions in the world frame (origin on the desk below
the arm's axis, x ahead of the arm, y to its left, z up).
"""

import math
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path

import numpy as np

from diagrams.world.names import ARM_JOINTS, DIRECTIVES
from models.checks import SMALLEST, require_number
from models.errors import InputError
from systems.arguments import require_count, require_positive, require_vector
from systems.clearance_filter import WITHIN

LARGEST_PICTURE = 2048  # pixels a side
LARGEST_GRID = 100  # positions a side
FARTHEST = 10.0  # m, of what is on the desk: no arm reaches so far
WIDEST = 1.0  # m, between the fingers: no hand opens so far
ACCELERATIONS = 1.0, 1e6  # rad/s^2: below, the arm hardly comes home; with the largest no step is cut
LARGEST_OFFSET = 0.2  # rad, of a joint: larger ones fling the can, see systems/README.md
CLEARANCE_CANS = ("possible", "known", "unseen")
RESUMPTIONS = ("reset", "imagined")
MOST_HALVINGS = 10  # of a period to a time step: a simulation of smaller ones would not end
POSITIVE = (
    "timing.time_step", "timing.period", "servo.finger_stiffness", "servo.finger_damping", "grid.spacing",
    "regulator.state_weight", "regulator.input_weight", "clearance.gap", "clearance.least", "clearance.rate",
)  # fmt: skip


@dataclass
class Timing:
    """Periods of the loop."""

    period: float = 0.1  # control tick, s (ten frames a second, Sec. IV-A)
    time_step: float = 0.0125  # step of the discrete plant, s: period / 8, see World.check


@dataclass
class Servo:
    """Joint servo: Drake's implicit PD, one gain a joint, clamped at the arm's effort limits."""

    stiffness: list[float] = field(
        default_factory=lambda: [2500.0, 2500.0, 1200.0, 1200.0, 350.0, 350.0, 120.0]
    )  # N m / rad
    damping: list[float] = field(default_factory=lambda: [100.0, 100.0, 45.0, 45.0, 12.0, 12.0, 4.0])  # N m s / rad
    finger_stiffness: float = 2000.0  # N / m
    finger_damping: float = 40.0  # N s / m


@dataclass
class Camera:
    """The fixed camera; a larger picture is averaged down to the network's 112 x 112 pixels (OpenCV's area filter)."""

    width: int = 112  # pixels
    height: int = 112  # pixels
    field_of_view_deg: float = 43.0  # vertical


@dataclass
class Grid:
    """Positions of the can on the desk (Sec. IV-A: 100 positions at intervals of 2 cm)."""

    corner: list[float] = field(default_factory=lambda: [0.44, -0.09])  # x, y of position (0, 0), m
    spacing: float = 0.02  # m
    count: int = 10  # a side

    def position(self, i: int, j: int) -> np.ndarray:
        """World x, y (m) of grid position (i, j)."""
        return np.asarray(self.corner) + self.spacing * np.array([i, j])

    def is_training(self, i: int, j: int) -> bool:
        """The paper's split, 50 positions each, as a checkerboard: the smallest holes between trained positions."""
        return (i + j) % 2 == 0

    def training_positions(self) -> np.ndarray:
        """(50, 2) world x, y of the trained positions, m."""
        side = range(self.count)
        return np.array([self.position(i, j) for i in side for j in side if self.is_training(i, j)])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the trained area, m."""
        lower = np.asarray(self.corner)
        return lower, lower + self.spacing * (self.count - 1)


@dataclass
class Regulator:
    """The LQR on the posture integrator m[k+1] = m[k] + dm[k], and its steps; 1 and 90 give a gain of 0.1 a tick."""

    state_weight: float = 1.0
    input_weight: float = 90.0
    acceleration: float = 14.0  # rad/s^2: how fast the steps grow, see systems/acceleration_limit.py
    offset: float = 0.0  # rad, largest one in spite of which a joint comes home: see systems/incremental_command.py


@dataclass
class Clearance:
    """The way home: what the arm keeps away from in mode `return`, see systems/clearance_filter.py."""

    cans: str = "possible"  # one wherever it may stand; known: where they stand; unseen: the way is straight, no filter
    gap: float = 0.01  # distance kept, m
    least: float = 0.005  # distance that the straight line to each command is proven to keep, m
    slip: float = 0.05  # that a can in the hand may have slid in it, m: it is kept so much farther away
    rate: float = 0.3  # share of the distance above the gap that a tick may use up
    learned_motion: bool = False  # filter the learned motion too


@dataclass
class World:
    """Everything about the robot and its desk that an episode does not sample."""

    models: str = "pick_place.dmd.yaml"  # file in sdf/ that says who stands where: see PARTS in parts.py
    timing: Timing = field(default_factory=Timing)
    servo: Servo = field(default_factory=Servo)
    camera: Camera = field(default_factory=Camera)
    grid: Grid = field(default_factory=Grid)
    regulator: Regulator = field(default_factory=Regulator)
    clearance: Clearance = field(default_factory=Clearance)
    resumption: str = "reset"  # at home: the network starts anew; imagined: when it has imagined its way to the end
    # The initial posture, to which the arm returns after each subtask and under the LQR: seven joint angles (deg).
    initial_joints_deg: list[float] = field(default_factory=lambda: [28.0, 30.0, 0.0, 83.0, 0.0, 62.0, 0.0])
    opening: float = 0.08  # gap of the open fingers, m
    closed_opening: float = 0.03  # commanded gap of the closed fingers, m: they stall on the can
    close_below: float = 0.045  # predicted gap below which closed fingers are commanded, m
    open_above: float = 0.065  # predicted gap above which open fingers are commanded, m
    # Measured gap below which fingers hold nothing, m: they open where the network starts anew. 0: they stay closed.
    empty_below: float = 0.035

    @property
    def initial_posture(self) -> np.ndarray:
        """(8,) joint angles (rad) and open fingers (m)."""
        return np.append(np.deg2rad(self.initial_joints_deg), self.opening)

    @property
    def releases(self) -> bool:
        """Whether fingers that hold nothing open at home, where the network starts anew."""
        return self.resumption == "reset" and self.empty_below > 0.0

    def check(self) -> None:
        """Raises InputError for a value that makes no world; of `models`, the station does for what it lacks."""
        if not self.models.endswith(DIRECTIVES) or Path(self.models).name != self.models:
            raise InputError(f"world.models '{self.models}' is no file's name in sdf/: give one like ARM{DIRECTIVES}")
        try:
            for name in POSITIVE:
                require_positive(f"world.{name}", attrgetter(name)(self))
            for name, least, most in (
                ("camera.width", 112, LARGEST_PICTURE), ("camera.height", 112, LARGEST_PICTURE),
                ("grid.count", 2, LARGEST_GRID),
            ):  # fmt: skip
                require_count(f"world.{name}", attrgetter(name)(self), least, most)
            require_vector("world.servo.stiffness", self.servo.stiffness, ARM_JOINTS, minimum=0.0)
            require_vector("world.servo.damping", self.servo.damping, ARM_JOINTS, minimum=0.0)
            require_vector("world.grid.corner", self.grid.corner, 2)
            for place in self.grid.corner:
                require_number("world.grid.corner", place, -FARTHEST, FARTHEST)
            require_number("world.grid.spacing", self.grid.spacing, SMALLEST, FARTHEST)
            require_number("world.regulator.acceleration", self.regulator.acceleration, *ACCELERATIONS)
            require_number("world.regulator.offset", self.regulator.offset, 0.0, LARGEST_OFFSET)
            require_vector("world.initial_joints_deg", self.initial_joints_deg, ARM_JOINTS)
        except ValueError as error:
            raise InputError(str(error)) from error
        period, step, angle = self.timing.period, self.timing.time_step, self.camera.field_of_view_deg
        # Drake counts both as k * period in doubles: one ulp later than the step, and the tick's updates run after it
        # and see the state that it made. Halves of the period have its digits.
        halvings = min(MOST_HALVINGS, max(0, round(math.log2(min(period / step, 1e6)))))
        if math.ldexp(step, halvings) != period:
            halved = period / 2**halvings
            raise InputError(
                f"world.timing.time_step {step} s: some ticks, every {period} s, are no step of the plant to the last "
                f"bit, and would see the posture a step late: choose {halved!r}, a period / 1, 2, 4, 8 ..."
            )
        if self.clearance.cans not in CLEARANCE_CANS:
            raise InputError(
                f"there are no cans '{self.clearance.cans}' (world.clearance.cans): choose from "
                f"{', '.join(CLEARANCE_CANS)}"
            )
        if self.resumption not in RESUMPTIONS:
            raise InputError(
                f"there is no resumption '{self.resumption}' (world.resumption): choose from {', '.join(RESUMPTIONS)}"
            )
        gap, slip, nearest, rate = (getattr(self.clearance, name) for name in ("gap", "slip", "least", "rate"))
        if not nearest < gap < WITHIN - slip or not slip >= 0.0 or rate > 1.0:
            raise InputError(
                f"world.clearance.least {nearest} m, gap {gap} m and slip {slip} m, rate {rate} do not fit: choose "
                f"least < gap, gap + slip < {WITHIN} m, a slip of 0 or more, and a rate of at most 1"
            )
        if not 0.0 < angle < 180.0:
            raise InputError(
                f"world.camera.field_of_view_deg {angle} is no angle of view: choose more than 0, below 180"
            )
        if not 0.0 <= self.closed_opening < self.opening <= WIDEST:
            raise InputError(
                f"world.closed_opening {self.closed_opening} m and opening {self.opening} m do not fit: "
                f"choose 0 <= closed_opening < opening <= {WIDEST}"
            )
        if not self.closed_opening <= self.close_below < self.open_above <= self.opening:
            raise InputError(
                f"world.close_below {self.close_below} m and open_above {self.open_above} m do not fit: choose "
                f"closed_opening {self.closed_opening} <= close_below < open_above <= opening {self.opening}"
            )
        if not self.closed_opening < self.empty_below <= self.close_below and self.empty_below != 0.0:
            raise InputError(
                f"world.empty_below {self.empty_below} m does not fit: choose more than closed_opening "
                f"{self.closed_opening}, at most close_below {self.close_below}, or 0 (never)"
            )
