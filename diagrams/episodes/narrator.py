"""What happens in a run, in a few words that a person can follow."""

from collections.abc import Callable

import numpy as np

from diagrams.episodes.switching import GUARD, RESUMED
from diagrams.world.task import TaskMonitor

MOVED_CAN = "the can is moved on the desk"
GIVEN_UP = "the return is given up: the network starts anew"


class Narrator:
    """Turns the ticks of a run into events (s, what happened)."""

    def __init__(self, monitor: TaskMonitor, tell: Callable[[float, str], None] | None):
        """`tell`: is told each event as it comes."""
        self.events: list[tuple[float, str]] = []
        self._monitor, self._tell = monitor, tell
        self._was: dict[str, bool] = {}
        self._given_up = False  # in the tick before

    def say(self, seconds: float, what: str) -> None:
        """Adds an event."""
        self.events.append((seconds, what))
        if self._tell is not None:
            self._tell(seconds, what)

    def give_up(self, seconds: float) -> None:
        """The return is given up, in the tick that was seen last."""
        self.say(seconds, GIVEN_UP)
        self._given_up = True

    def see(
        self,
        seconds: float,
        posture: np.ndarray,
        alpha: float,
        active: bool,
        taken: bool,
        cans: np.ndarray,
        home: bool,
    ) -> None:
        """One tick: `posture` (8,), `cans` (14,); whether the arm is disturbed, the can was taken, the arm is home."""
        monitor = self._monitor
        held = bool(monitor.held(cans, posture))
        placed = bool(monitor.placed(cans))
        returning = alpha >= GUARD or (self._was.get("returning", False) and alpha > RESUMED)
        resumes = None if self._given_up else "recalls again: the network resumes"
        for name, now, begins, ends in (
            (
                "taken",
                taken,
                "the can is taken from the hand and put elsewhere on the desk" if active else MOVED_CAN,
                None,
            ),
            ("subtask 1", not held and not placed, "subtask 1: pick the can", None),
            ("disturbed", active, "the experimenter disturbs the arm", "the experimenter lets the arm go"),
            ("returning", returning, "recall fails: switched to the LQR", resumes),
            ("home", returning and home, "at the initial posture", None),
            ("held", held, "picked; subtask 2: place the can", None),
            ("placed", placed and bool(monitor.released(posture)), "placed", None),
        ):
            if now != self._was.get(name, False):
                text = begins if now else ends
                if text is not None:
                    self.say(seconds, text)
            self._was[name] = now
        self._given_up = False
