"""A Session in time: pause, single tick, speed; what it says of itself; where it is saved."""

import time
from pathlib import Path

from diagrams.browser.pace import Lengths, Pace
from diagrams.browser.session import Session

SLICE = 0.03  # s: at the fastest, so long at a time, then the pages have their turn
BEHIND = 0.05  # share of late ticks from which on the page says so


class Run:
    """What the server runs and the pages talk to.

    Attributes:
        session: what is run.
        pace: when.
        paused: whether only single ticks are run.
        delays: from the end of a tick to when a page said that it had drawn it, s.
    """

    def __init__(self, session: Session, speed: float, save: Path):
        """`speed`: simulated over real time, 0: the fastest; `save`: file of `save`."""
        self.session, self.pace, self.paused = session, Pace(session.period, speed), False
        self._save, self.delays = save, Lengths()

    def work(self) -> float:
        """Runs what is due; returns how long it is until there is more, s."""
        began = time.monotonic()
        while not self.paused and not (wait := self.pace.wait(now := time.monotonic())):
            self._tick(now)
            if time.monotonic() - began > SLICE:
                return 0.0
        return 0.02 if self.paused else wait

    def _tick(self, now: float) -> None:
        self.session.tick()
        self.pace.ran(now, time.monotonic())
        if self.session.ended:
            self.pause(True)

    def pause(self, paused: bool) -> None:
        """Stops, or goes on."""
        self.paused = paused
        if not paused:
            self.session.ended = ""
        self.pace.rest()

    def single(self) -> None:
        """Runs one tick, and pauses."""
        self.pause(True)
        self.session.tick()

    def set_speed(self, speed: float) -> None:
        """Simulated over real time; 0: the fastest."""
        self.pace.speed = speed
        self.pace.rest()

    def next_scene(self) -> None:
        """Begins the next scene."""
        self.session.next_scene()
        self.pause(False)

    def choose(self, **changes) -> None:
        """See Session.choose."""
        self.session.choose(**changes)
        self.pause(False)

    def save(self) -> Path:
        """Writes the scene as it was played so far; returns where."""
        self.session.save(self._save)
        self.session.events.append((self.session.seconds, f"written: {self._save}"))
        return self._save

    @property
    def ticks_a_picture(self) -> int:
        """After how many ticks the pages show another picture: five a second."""
        return max(1, round(0.2 / self.session.period * max(self.pace.speed, 1.0 if self.pace.speed else 10.0)))

    def words(self) -> str:
        """Mode, dwell time, and how the clock is kept, as HTML."""
        session = self.session
        colour = "#2f855a" if session.mode.startswith("the network") else "#c53030"
        dwell = max(0.0, session.seconds - session.since)
        text = f'<b style="color: {colour}">{session.mode}</b>, for {dwell:.1f} s'
        if session.rows and session.rows[-1]["active"]:
            text += ' <b style="color: #dd6b20">the arm is disturbed</b>'
        speed, behind = self.pace.speed, self.pace.behind()
        if self.paused:
            clock = session.ended or "paused"
        elif not speed:
            clock = "as fast as it can"
        elif behind > BEHIND:
            clock = f'<b style="color: #c53030">behind real time: {100 * behind:.0f} % of the last ticks are late</b>'
        else:
            clock = "in real time" if speed == 1.0 else f"{speed:g} times real time"
        return f"{text}<br>{session.seconds:.1f} s in the scene, {clock}"
