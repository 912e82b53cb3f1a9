"""A Session in time: pause, single tick, speed; what it says of itself; where it is saved."""

import time
from collections.abc import Callable
from pathlib import Path

from diagrams.browser.pace import Lengths, Pace
from diagrams.browser.session import Session
from diagrams.world.hands_schedule import HandsSchedule
from models.errors import InputError

SLICE = 0.03  # s: where a tick is always due, so long at a time, then the pages have their turn
# s: their turn, for a message of a page takes several rounds of the loop; and the longest wait, so that another speed
# holds at once.
LEAST_WAIT, LONGEST_WAIT = 0.01, 0.05
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
        """`speed`: simulated over real time, 0: the fastest; `save`: file of the first scene that is saved."""
        self.session, self.pace, self.paused = session, Pace(session.period, speed), False
        self._save, self.delays = save, Lengths()
        self._numbers: dict[int, int] = {}  # of the files, by their scene
        self._kept: tuple[int, HandsSchedule] | None = None  # scene, and what is in its file

    def work(self) -> float:
        """Runs what is due; returns for how long the pages have their turn, s: LEAST_WAIT to LONGEST_WAIT."""
        began, wait = time.monotonic(), LONGEST_WAIT
        while not self.paused and not (wait := self.pace.wait(now := time.monotonic())):
            self._tick(now)
            if time.monotonic() - began > SLICE:
                break
        return min(max(wait, LEAST_WAIT), LONGEST_WAIT)

    def _tick(self, now: float) -> None:
        self.session.tick()
        self.pace.ran(now, time.monotonic())
        if self.session.ended:
            self.pause(True)

    def pause(self, paused: bool) -> None:
        """Stops, or goes on; raises InputError where the scene cannot."""
        if not paused:
            self.session.require_going()
        self.paused = paused
        if not paused:
            self.session.ended = ""
        self.pace.rest()

    def single(self) -> None:
        """Runs one tick, and pauses; raises InputError where the scene cannot go on."""
        self.pause(True)
        self.session.tick()

    def set_speed(self, speed: float) -> None:
        """Simulated over real time; 0: the fastest."""
        self.pace.set_speed(speed)

    def next_scene(self) -> None:
        """Begins the next scene; what was done in this one is kept."""
        self._leave(self.session.next_scene)

    def choose(self, **changes) -> None:
        """See Session.choose; what was done in this scene is kept."""
        self._leave(lambda: self.session.choose(**changes))

    def _leave(self, begin: Callable[[], None]) -> None:
        """Raises InputError, in the new scene, where the old one could not be written."""
        lost, path = None, None
        try:
            path = self.keep()
        except InputError as error:
            lost = error
        begin()
        self.pause(False)
        if path is not None:
            self._say_written(path)
        if lost is not None:
            raise lost

    def save(self) -> Path:
        """Writes the scene as it was played so far; returns where: each scene has a file of its own.

        Raises InputError where it cannot be written.
        """
        number = self._numbers.get(self.session.scene, len(self._numbers) + 1)
        path = self._save if number == 1 else self._save.with_stem(f"{self._save.stem}-{number}")
        self.session.save(path)
        self._numbers[self.session.scene] = number
        self._kept = self.session.scene, self.session.recorded().hands
        self._say_written(path)
        return path

    def keep(self) -> Path | None:
        """Saves where hands did something since it was saved last; see `save`."""
        hands = self.session.recorded().hands
        return self.save() if hands and self._kept != (self.session.scene, hands) else None

    def _say_written(self, path: Path) -> None:
        self.session.events.append((self.session.seconds, f"written: {path}"))

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
        wanted = "real time" if speed == 1.0 else f"{speed:g} times real time"
        if self.paused:
            clock = session.ended or "paused"
        elif not speed:
            clock = "as fast as it can"
        elif behind > BEHIND:
            clock = f'<b style="color: #c53030">behind {wanted}: {100 * behind:.0f} % of the last ticks are late</b>'
        else:
            clock = f"in {wanted}" if speed == 1.0 else wanted
        return f"{text}<br>{session.seconds:.1f} s in the scene, {clock}"
