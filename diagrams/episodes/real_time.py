"""Real time: a run that waits for the clock, and what its ticks took of it."""

import time

import numpy as np


class RealTime:
    """`wait` is called after each tick: it returns when the next one is due."""

    def __init__(self, period: float, rate: float):
        """`period`: of the ticks in simulated time, s; `rate`: simulated over real time; 0: nothing is waited for."""
        self.due = period / rate if rate else 0.0  # s of the clock from one tick to the next
        self._first: float | None = None

    def wait(self, ticks: int) -> None:
        """After the first `ticks` of a run. What a late tick lost is made up for by the next ones."""
        now = time.monotonic()
        if self._first is None:
            self._first = now - self.due * (ticks - 1)  # as if the first tick had taken no time
        time.sleep(max(0.0, self._first + self.due * ticks - now))


def tick_words(seconds: np.ndarray, due: float) -> str:
    """What the ticks of a run took, in a line; `seconds`: (n,) of each, waiting not counted; `due`: s one may take."""
    late, milliseconds = int((seconds > due).sum()), 1e3 * seconds
    typical, most = np.quantile(milliseconds, [0.5, 0.99])
    return (
        f"{late} of {len(seconds)} ticks late (over {1e3 * due:.0f} ms); a tick takes {typical:.1f} ms in the median, "
        f"{most:.1f} ms at 99 %, {milliseconds.max():.1f} ms at most"
    )
