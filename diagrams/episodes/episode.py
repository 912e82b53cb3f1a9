"""Episode and outcome: the unit of everything that is counted."""

import dataclasses
from dataclasses import dataclass, field

from diagrams.world.disturbance import DisturbanceSpec

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


@dataclass
class Outcome:
    """What came of an episode; None where a field has no meaning (undisturbed, never reached)."""

    seed: int
    rnn: str
    detector: str
    disturbance: str
    can_xy: tuple[float, float]
    vacant: str
    picked: bool
    placed: bool
    home: bool
    success: bool | None  # None: not asked for, see Until in switching.py
    switched: bool
    detection_delay_s: float | None
    false_switches: int
    returned: bool | None
    resumed: bool | None
    switch_success: bool
    paper_switch_success: bool | None  # in the paper's words; None: not asked for
    alpha_max_before: float
    return_s: float | None  # from the end of the disturbance to the initial posture
    resume_s: float | None  # from the initial posture to alpha <= 0.1
    failure: str | None  # of SWITCHING_FAILURES, TASK_FAILURES, or "simulation diverged"
    switch_failure: str | None  # of SWITCHING_FAILURES, or "simulation diverged"
    sim_seconds: float
    wall_seconds: float = 0.0
    realtime_factor: float = 0.0
    weights_hash: str = ""

    def to_dict(self) -> dict:
        """Plain types, for JSON."""
        return dataclasses.asdict(self)
