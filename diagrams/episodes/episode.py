"""Episode and outcome: the unit of everything that is counted."""

import dataclasses
from dataclasses import dataclass, field

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands_schedule import HandsSchedule
from systems.recoveries.registry import SHIPPED

DIVERGED = "simulation diverged"  # a failure of the task and of the switching


@dataclass(frozen=True)
class Episode:
    """A scene, a disturbance and a controller."""

    seed: int
    can_xy: tuple[float, float]  # m, world
    vacant: str  # left or right
    disturbance: DisturbanceSpec = field(default_factory=DisturbanceSpec)
    rnn: str = "lstm"
    detector: str = "recall"
    # Whether the straight way home from the disturbance is clear; None: undisturbed, or not looked at.
    way_home_clear: bool | None = None
    hands: HandsSchedule = field(default_factory=HandsSchedule)  # what a person did beside it
    recovery: str = SHIPPED  # short name


@dataclass
class Outcome:
    """What came of an episode; None where a field has no meaning (undisturbed, never reached, see outcome.py)."""

    seed: int
    rnn: str
    detector: str
    disturbance: str  # its short name
    can_xy: tuple[float, float]  # m, world
    vacant: str
    picked: bool
    placed: bool
    home: bool
    void: bool  # the disturbance never came: neither a success nor a failure, see switching.py
    way_home_clear: bool | None  # see Episode
    success: bool | None  # None: void, or not asked for, see Until in switching.py
    switched: bool
    detection_delay_s: float | None  # from the onset to alpha >= 0.9
    guard_crossings: int  # of alpha through 1/2, up and down, in the whole run
    false_switches: int | None  # before the onset
    later_switches: int | None  # after the network had the arm again
    needless_s: float | None  # alpha >= 1/2 that no disturbance explains
    returned: bool | None
    resumed: bool | None
    switch_success: bool | None  # None: void, or not asked for
    paper_switch_success: bool | None  # in the paper's words; None: void, or not asked for
    alpha_max_before: float | None  # the onset
    return_s: float | None  # from the end of the disturbance to the initial posture
    resume_s: float | None  # from the initial posture to alpha <= 0.1
    way_home_m: float | None  # smallest distance to anything on the ways home, see way_home.py; None: none was gone
    way_home_nearest: str | None  # the model that was that near
    failure: str | None  # what went wrong first, of SWITCHING_FAILURES, TASK_FAILURES, or "simulation diverged"
    switch_failure: str | None  # of SWITCHING_FAILURES, or "simulation diverged"
    sim_seconds: float  # of simulated time
    wall_seconds: float = 0.0
    realtime_factor: float = 0.0
    weights_hash: str = ""
    severity: float | None = None  # of a fault; None: the disturbance has none
    recovery: str = SHIPPED  # what the arm does after an alarm, of systems/recoveries/

    @property
    def judged(self) -> bool:
        """Whether the switching is: the arm was disturbed once at most, and nothing else was wrong."""
        return self.false_switches is not None

    def to_dict(self) -> dict:
        """Plain types, for JSON."""
        return dataclasses.asdict(self)
