"""What can be configured, as dataclasses: defaults here, a YAML file or the command line over them.

Units: m, rad, s, N m unless a field's comment says otherwise; positions in the world frame (origin on the desk below the arm's axis, x ahead of
the arm, y to its left, z up).
"""

# No `from __future__ import annotations` here: Drake reads the types of the fields.
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from models.command_line import ROOT
from models.errors import InputError
from systems.arguments import require_count, require_positive, require_vector

WEIGHTS = ROOT / "models" / "weights"  # the repository's trained networks
SPOTS = ("left", "right")


@dataclass
class Timing:
    """Periods of the loop."""

    period: float = 0.1  # control tick, s (ten frames a second, Sec. IV-A)
    time_step: float = 0.01  # step of the discrete plant, s


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
        """The split of the paper, 50 positions each: the checkerboard leaves the smallest holes between trained positions."""
        return (i + j) % 2 == 0

    def training_positions(self) -> np.ndarray:
        """(50, 2) world x, y of the trained positions, m."""
        return np.array(
            [self.position(i, j) for i in range(self.count) for j in range(self.count) if self.is_training(i, j)]
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the trained area, m."""
        lower = np.asarray(self.corner)
        return lower, lower + self.spacing * (self.count - 1)


@dataclass
class Regulator:
    """Weights of the LQR on the posture integrator m[k+1] = m[k] + dm[k]; 1 and 90 give a gain of 0.1 a tick."""

    state_weight: float = 1.0
    input_weight: float = 90.0


@dataclass
class World:
    """Everything about the robot and its desk that an episode does not draw."""

    timing: Timing = field(default_factory=Timing)
    servo: Servo = field(default_factory=Servo)
    camera: Camera = field(default_factory=Camera)
    grid: Grid = field(default_factory=Grid)
    regulator: Regulator = field(default_factory=Regulator)
    # The initial posture, to which the arm returns after each subtask: seven joint angles (deg); it is also the LQR's target.
    initial_joints_deg: list[float] = field(default_factory=lambda: [28.0, 30.0, 0.0, 83.0, 0.0, 62.0, 0.0])
    opening: float = 0.08  # gap of the open fingers, m
    closed_opening: float = 0.03  # commanded gap of the closed fingers, m: they stall on the can

    @property
    def initial_posture(self) -> np.ndarray:
        """(8,) joint angles (rad) and open fingers (m)."""
        return np.append(np.deg2rad(self.initial_joints_deg), self.opening)

    def check(self) -> None:
        """Raises InputError for a value that makes no world."""
        timing, servo, camera, grid = self.timing, self.servo, self.camera, self.grid
        try:
            require_positive("world.timing.time_step", timing.time_step)
            require_positive("world.timing.period", timing.period)
            require_vector("world.servo.stiffness", servo.stiffness, 7, minimum=0.0)
            require_vector("world.servo.damping", servo.damping, 7, minimum=0.0)
            require_positive("world.servo.finger_stiffness", servo.finger_stiffness)
            require_positive("world.servo.finger_damping", servo.finger_damping)
            require_count("world.camera.width", camera.width, 112)
            require_count("world.camera.height", camera.height, 112)
            require_vector("world.grid.corner", grid.corner, 2)
            require_positive("world.grid.spacing", grid.spacing)
            require_count("world.grid.count", grid.count, 2)
            require_positive("world.regulator.state_weight", self.regulator.state_weight)
            require_positive("world.regulator.input_weight", self.regulator.input_weight)
            require_vector("world.initial_joints_deg", self.initial_joints_deg, 7)
        except ValueError as error:
            raise InputError(str(error)) from error
        off = abs(math.remainder(timing.period, timing.time_step))
        if timing.period < timing.time_step or off > 1e-6 * timing.time_step:
            raise InputError(
                f"world.timing.period {timing.period} s is no multiple of time_step {timing.time_step} s: change one of them"
            )
        if not 0.0 < camera.field_of_view_deg < 180.0:
            raise InputError(
                f"world.camera.field_of_view_deg {camera.field_of_view_deg} is no angle of view: choose more than 0, less than 180"
            )
        if not 0.0 <= self.closed_opening < self.opening < math.inf:
            raise InputError(
                f"world.closed_opening {self.closed_opening} m and opening {self.opening} m do not fit: choose 0 <= closed_opening < opening"
            )


RNNS = ("lstm", "gru", "mtrnn")
DISTURBANCES = ("none", "A", "B")
DETECTORS = ("recall", "knn", "subspace")


@dataclass
class Experimenter:
    """The disturbance in full: with a `level` nothing about it is drawn; without one all of it is."""

    level: float | None = None  # distance to the goal at which it begins, m
    subtask: int = 1  # 1: the distance is the hand's to the can; 2: the held can's to its spot
    target: list[float] | None = None  # kind A: where the arm is moved to, seven joint angles, rad
    hold_ticks: int = 0  # how long it is held there (A) or stopped (B), ticks
    can_moved_to: list[float] | None = None  # X Y where the can is put meanwhile, m, world

    def check(self, kind: str) -> None:
        """Raises InputError for what does not make a disturbance of `kind`; without a disturbance nothing of it is read."""
        if kind == "none":
            return
        if self.level is None:
            if self != Experimenter():
                raise InputError(
                    "experimenter.level is missing, without which the disturbance is drawn: give it in metres"
                )
            return
        if not 0 < self.level < float("inf"):
            raise InputError(f"experimenter.level {self.level} is no distance: give a number greater than 0, in metres")
        if self.subtask not in (1, 2):
            raise InputError(f"there is no subtask {self.subtask} (experimenter.subtask): choose 1 or 2")
        if self.hold_ticks < (1 if kind == "B" else 0):
            raise InputError(f"experimenter.hold_ticks {self.hold_ticks} is too short: choose 1 or more (A: 0 or more)")
        wanted = 7 if kind == "A" else 0
        if len(self.target or []) != wanted or not np.all(np.isfinite(self.target or [])):
            raise InputError(
                f"experimenter.target {self.target} does not fit disturbance {kind}: give {wanted} joint angles in rad"
            )
        moved = self.can_moved_to
        if moved is not None and (len(moved) != 2 or not np.all(np.isfinite(moved))):
            raise InputError(f"experimenter.can_moved_to {moved} is not two numbers: give x and y in metres")


@dataclass
class Scenario:
    """One episode and its world: what a scenario file can hold."""

    rnn: str = "lstm"  # lstm, gru or mtrnn
    detector: str = "recall"  # recall, knn or subspace
    disturbance: str = "A"  # none, A or B
    seed: int = 0  # draws the can's position, the vacant spot, and the disturbance's moment and posture
    can: list[float] | None = None  # X Y of the can to pick, m, world; drawn where not given
    vacant: str | None = None  # left or right; drawn where not given
    experimenter: Experimenter = field(default_factory=Experimenter)
    world: World = field(default_factory=World)

    def check(self) -> None:
        """Raises InputError for a value outside its choices."""
        for name, value, choices in (
            ("rnn", self.rnn, RNNS),
            ("detector", self.detector, DETECTORS),
            ("disturbance", self.disturbance, DISTURBANCES),
            ("vacant spot", self.vacant, (*SPOTS, None)),
        ):
            if value not in choices:
                raise InputError(f"there is no {name} '{value}': choose one of {', '.join(c for c in choices if c)}")
        if self.seed < 0:
            raise InputError(f"the seed {self.seed} is negative: choose a whole number from 0 on")
        if self.can is not None and len(self.can) != 2:
            raise InputError(f"the can's position {self.can} does not have two numbers: give x and y in metres")
        self.experimenter.check(self.disturbance)
        self.world.check()


def load_scenario(path: Path) -> Scenario:
    """The scenario in the YAML file `path`, over the defaults; raises InputError for a key or a value that does not fit."""
    from pydrake.common.yaml import yaml_load_typed

    if not path.is_file():
        raise InputError(f"there is no scenario file {path}: check the name")
    try:
        return yaml_load_typed(schema=Scenario, filename=str(path), defaults=Scenario())
    except Exception as error:  # the loader raises many types, each with its own words for what does not fit
        reason = " ".join(str(error).split())
        raise InputError(
            f"the scenario file {path} does not fit: {reason}; see Scenario in diagrams/world/scenario.py for its keys"
        ) from error


def save_scenario(path: Path, scenario: Scenario, comments: list[str] | None = None) -> None:
    """Writes what differs from the defaults to the YAML file `path`; `load_scenario` gives the same bits back. `comments`: lines above it."""
    from pydrake.common.yaml import yaml_dump_typed

    text = yaml_dump_typed(scenario, defaults=Scenario())
    path.write_text("".join(f"# {line}\n" for line in comments or []) + text)
