"""When the next tick is due, and how many came too late."""

import numpy as np

BINS = np.arange(0.0, 1.0001, 0.0005)  # s: of the histograms; what is longer counts as 1 s
RECENT = 100  # ticks


class Lengths:
    """A histogram of times (s): its quantiles, in memory that does not grow."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(BINS), int)

    def add(self, seconds: float) -> None:
        """One more."""
        self._counts[np.searchsorted(BINS, min(max(seconds, 0.0), BINS[-1]), side="right") - 1] += 1

    def __len__(self) -> int:
        return int(self._counts.sum())

    def quantile(self, share: float) -> float:
        """To half a millisecond above; 0 where there is none."""
        whole = np.cumsum(self._counts)
        return float(BINS[min(np.searchsorted(whole, share * whole[-1]) + 1, len(BINS) - 1)]) if whole[-1] else 0.0


class Pace:
    """Keeps to the clock. All times s; the caller says what time it is."""

    def __init__(self, period: float, speed: float = 1.0):
        """`period`: of the ticks in simulated time; `speed`: simulated over real; 0: as fast as can be."""
        self._period, self.speed = period, speed
        self._due: float | None = None
        self.lengths = Lengths()  # of the ticks
        self._recent = np.zeros(RECENT, bool)
        self.ticks = self.late = self._paced = self._timed = 0  # _paced: at this speed; _timed: at real time

    @property
    def step(self) -> float:
        """Real time from one tick to the next."""
        return self._period / self.speed if self.speed else 0.0

    def rest(self) -> None:
        """No tick is due: a pause, a new scene; the next tick begins the count anew."""
        self._due = None

    def set_speed(self, speed: float) -> None:
        """Another one; what was late at the last is forgotten."""
        self.speed = speed
        self._recent[:] = False
        self._paced = 0
        self.rest()

    def wait(self, now: float) -> float:
        """How long it is until the next tick is due; 0: it is."""
        return 0.0 if self._due is None or not self.speed else max(0.0, self._due - now)

    def ran(self, began: float, ended: float) -> None:
        """A tick was run from `began` to `ended`. It is late if it ended after the next one was due."""
        self.lengths.add(ended - began)
        self.ticks += 1
        if not self.speed:
            return
        due = began if self._due is None else self._due
        late = ended > due + self.step
        self._recent[self._paced % RECENT] = late
        self._paced += 1
        if self.speed == 1.0:
            self.late += late
            self._timed += 1
        # What was lost is not made up for by haste, but for one tick.
        self._due = due + self.step if ended <= due + 2 * self.step else ended

    def behind(self) -> float:
        """Share of the last ticks that were late."""
        return float(self._recent.sum() / max(1, min(self._paced, RECENT)))

    def words(self) -> str:
        """All of it, in a line."""
        if not self.ticks:
            return "no tick was run"
        late = f"{self.late} of {self._timed} ticks late at real time ({100 * self.late / max(self._timed, 1):.1f} %)"
        return (
            f"{self.ticks} ticks; {late}; a tick takes {1e3 * self.lengths.quantile(0.5):.1f} ms in the median, "
            f"{1e3 * self.lengths.quantile(0.99):.1f} ms at 99 %"
        )
