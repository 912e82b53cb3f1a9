"""The switching of a run, and the one definition of its success.

Disturbed: alpha < 0.5 at every tick before the onset; alpha >= 0.9 before the end of the disturbance + 5 ticks; from
then on alpha >= 0.5 until the arm is at its initial posture; alpha <= 0.1 within 6 s after that. Undisturbed: alpha <
0.5 throughout.
Beside it, for the comparison with the paper, whose words ask for less: alpha >= 0.9 as above, and the arm at its
initial posture at some later tick, whoever led it there and whatever alpha was meanwhile, with alpha <= 0.1 within 6 s
after that tick. Undisturbed: as above.
"""

from dataclasses import dataclass
from typing import Literal

from systems.detector import GUARD

DETECTED, RESUMED = 0.9, 0.1  # values of alpha
DETECTION_TICKS = 5  # after the end of the disturbance
RESUME_SECONDS = 6.0  # after the arm is at its initial posture

# When a run ends before its time is up: with the task done; or once the switching's success, or the detection's, is
# decided.
Until = Literal["task", "switching", "detection"]

DEFEATS = ("not detected", "not returned", "not resumed")
SWITCHING_FAILURES = ("false switch", "not disturbed", *DEFEATS)


@dataclass
class Switching:
    """The switching of one run, told tick by tick; tick indices are None where the event did not come."""

    disturbed: bool  # whether a disturbance was due
    period: float  # s
    ticks: int = 0  # seen
    false_switches: int = 0
    alpha_max_before: float = 0.0  # the onset
    onset: int | None = None
    end: int | None = None  # first tick after the disturbance
    detected: int | None = None
    let_go: int | None = None  # by the LQR, alpha < 0.5, at home or not
    home: int | None = None
    resumed: int | None = None
    _last_home: int | None = None
    _resumed_as_in_paper: bool = False
    _high: bool = False

    def see(self, alpha: float, active: bool, at_home: bool) -> None:
        """The next tick; `active`: the arm is disturbed, once a run in one stretch; `at_home`: see task.py."""
        k, high = self.ticks, alpha >= GUARD
        self.ticks += 1
        if self.onset is None and self.disturbed and active:
            self.onset = k
        if self.onset is None:
            self.false_switches += high and not self._high
            self.alpha_max_before = max(self.alpha_max_before, alpha)
            self._high = high
            return
        if self.end is None and not active:
            self.end = k
        if self.detected is None and alpha >= DETECTED and (self.end is None or k < self.end + DETECTION_TICKS):
            self.detected = k
        if self.detected is None or self.end is None:
            return
        if self.let_go is None and not high:
            self.let_go = k
        if at_home:
            self._last_home = k
            if self.home is None and self.let_go is None:
                self.home = k
        if alpha <= RESUMED:
            if self.resumed is None and self._patient(self.home, k):
                self.resumed = k
            self._resumed_as_in_paper |= self._patient(self._last_home, k)

    def _patient(self, home: int | None, k: int) -> bool:
        """Whether tick k is within RESUME_SECONDS of the tick `home`."""
        return home is not None and k <= home + round(RESUME_SECONDS / self.period)

    @property
    def as_in_paper(self) -> bool:
        """Success in the paper's words."""
        return self.failure is None if self.onset is None else self._resumed_as_in_paper

    @property
    def failure(self) -> str | None:
        """What is missing so far; None: nothing."""
        if self.false_switches:
            return "false switch"
        if self.onset is None:
            return "not disturbed" if self.disturbed else None
        if self.detected is None:
            return "not detected"
        if self.home is None:
            return "not returned"
        return "not resumed" if self.resumed is None else None

    @property
    def detection_over(self) -> bool:
        """Whether the disturbance is over, and the ticks in which it had to be noticed."""
        return self.end is not None and self.ticks >= self.end + DETECTION_TICKS

    @property
    def decided(self) -> bool:
        """Whether no later tick can change `failure`."""
        if self.false_switches or self.resumed is not None:
            return True
        if self.end is None:
            return False
        if self.detected is None:
            return self.detection_over
        return self.let_go is not None if self.home is None else not self._patient(self.home, self.ticks)

    @property
    def ticks_disturbed(self) -> int:
        """From the onset until the network has the arm again; else the disturbance alone."""
        if self.onset is None or self.end is None:
            return 0
        return (self.resumed if self.resumed is not None else self.end) - self.onset
