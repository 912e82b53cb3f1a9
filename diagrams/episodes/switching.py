"""The switching of a run, and the one definition of its success.

Disturbed: alpha < 0.5 at every tick before the onset; alpha >= 0.9 at a tick before the end of the disturbance; from
then on alpha >= 0.5 until the arm is at its initial posture (after the disturbance: held there, it has not returned);
alpha <= 0.1 within 6 s after that; alpha < 0.5 from then to the end of the run. Undisturbed: alpha < 0.5 throughout.
A disturbance that never came makes the run void: neither a success nor a failure. A false switch before is a failure
nevertheless: by it, the disturbance may have been kept away.

Beside it, in the paper's words, which ask for less: alpha >= 0.9 before the end of the disturbance, and the arm at its
initial posture at some later tick, whoever led it there and whatever alpha was before and between, with alpha <= 0.1
within 6 s after that tick. Undisturbed: as above. A figure of the paper stands beside this one alone.
"""

from dataclasses import dataclass
from typing import Literal

from systems.detector import GUARD

DETECTED, RESUMED = 0.9, 0.1  # values of alpha
RESUME_SECONDS = 6.0  # after the arm is at its initial posture

# What a run ends with before its time is up: the task done. Before that: once the switching has failed; once its
# success in the paper's words is decided; once the disturbance is over.
Until = Literal["task", "switching", "as_paper", "detection"]

DEFEATS = ("not detected", "not returned", "not resumed", "switched again")
SWITCHING_FAILURES = ("false switch", *DEFEATS)


@dataclass
class Switching:
    """The switching of one run, told tick by tick; tick indices are None where the event did not come."""

    disturbed: bool  # whether the arm is to be disturbed
    period: float  # s
    several: bool = False  # whether it is disturbed more than once: then no success of the switching is defined
    ticks: int = 0  # seen
    crossings: int = 0  # of alpha through 1/2, up and down
    false_switches: int = 0  # rises through 1/2 before the onset
    later_switches: int = 0  # rises after the network has the arm again
    needless_ticks: int = 0  # alpha >= 1/2 before the onset, and after the one return that the disturbance explains
    alpha_max_before: float = 0.0  # the onset
    onset: int | None = None
    end: int | None = None  # first tick after the disturbance
    detected: int | None = None
    let_go: int | None = None  # by the LQR, alpha < 0.5, before the arm was at home
    home: int | None = None
    resumed: int | None = None
    failed: int | None = None  # at which tick `failure` was decided
    _lost: int = 0  # ticks in which the arm was disturbed, or led home after that to where the network had it again
    _led: int = 0  # ticks of the way home that is under way
    _last_home: int | None = None
    _resumed_as_in_paper: bool = False
    _high: bool = False
    _risen: bool = False  # since the onset
    _explained: bool = False  # whether the return that the disturbance explains is over

    def see(self, alpha: float, active: bool, at_home: bool) -> None:
        """The next tick; `active`: the arm is disturbed, once a run in one stretch; `at_home`: see task.py."""
        k, high, rises = self.ticks, alpha >= GUARD, alpha >= GUARD and not self._high
        self.ticks += 1
        self.crossings += high != self._high
        self._high = high
        if self.onset is None and self.disturbed and active:
            self.onset = k
        if self.onset is None:
            self.false_switches += rises
            self.needless_ticks += high
            self.alpha_max_before = max(self.alpha_max_before, alpha)
        else:
            self._see_disturbed(k, alpha, active, at_home, rises)
        if self.failed is None and self.failure in SWITCHING_FAILURES and self._final:
            self.failed = k

    def _see_disturbed(self, k: int, alpha: float, active: bool, at_home: bool, rises: bool) -> None:
        """A tick from the onset on."""
        high = alpha >= GUARD
        self._lost += active
        self._led += not active and alpha > RESUMED
        if alpha <= RESUMED:
            self._lost, self._led = self._lost + self._led, 0
        if self.end is None and not active:
            self.end = k
        if self.detected is None and self.end is None and alpha >= DETECTED:
            self.detected = k
        self.later_switches += rises and self.resumed is not None
        self._risen |= high
        if self.detected is not None:
            if self.let_go is None and self.home is None and not high:
                self.let_go = k
            if at_home and self.end is not None:
                self._last_home = k
                if self.home is None and self.let_go is None:
                    self.home = k
            if alpha <= RESUMED:
                if self.resumed is None and self._patient(self.home, k):
                    self.resumed = k
                self._resumed_as_in_paper |= self._patient(self._last_home, k)
        self.needless_ticks += high and self._explained
        if self.end is not None and self._risen:
            self._explained |= self.resumed is not None or (not high and not self._patient(self.home, k))

    def _patient(self, home: int | None, k: int) -> bool:
        """Whether tick k is within RESUME_SECONDS of the tick `home`."""
        return home is not None and k <= home + round(RESUME_SECONDS / self.period)

    @property
    def void(self) -> bool:
        """Whether the disturbance has not come."""
        return self.disturbed and self.onset is None

    @property
    def failure(self) -> str | None:
        """What is missing so far, of SWITCHING_FAILURES, what went wrong first; None: nothing, or the run is void."""
        if self.false_switches:
            return "false switch"
        if self.onset is None:
            return None
        if self.detected is None:
            return "not detected"
        if self.home is None:
            return "not returned"
        if self.resumed is None:
            return "not resumed"
        return "switched again" if self.later_switches else None

    @property
    def success(self) -> bool | None:
        """Whether the switching is as it should be so far; None: void."""
        return None if self.void and not self.false_switches else self.failure is None

    @property
    def as_paper(self) -> bool | None:
        """Success in the paper's words so far; None: void."""
        if self.void:
            return None
        return self.failure is None if self.onset is None else self._resumed_as_in_paper

    @property
    def _final(self) -> bool:
        """Whether `failure` stays, whatever comes."""
        if self.false_switches or self.later_switches:
            return True
        if self.detected is None:
            return self.end is not None
        if self.home is None:
            return self.let_go is not None
        return self.resumed is None and not self._patient(self.home, self.ticks)

    def over(self, until: Until) -> bool:
        """Whether a run that ends with `until` needs no further tick: none can change what it is run for."""
        if until == "switching":
            return self.failed is not None
        if until == "as_paper":
            undisturbed = self.onset is None and not self.disturbed
            unnoticed = self.end is not None and self.detected is None
            return bool(undisturbed and self.false_switches) or unnoticed or self._resumed_as_in_paper
        return until == "detection" and self.end is not None

    @property
    def ticks_disturbed(self) -> int:
        """From the onset until the network has the arm again; else the disturbance alone, as far as it has come.

        Of several disturbances, those ticks of each.
        """
        if self.onset is None:
            return 0
        if self.several:
            return self._lost
        return next(k for k in (self.resumed, self.end, self.ticks) if k is not None) - self.onset
