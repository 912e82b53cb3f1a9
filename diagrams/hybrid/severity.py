"""Severity: how near a disturbed run came to a defeat, the level that splitting climbs.

Defeated means that the switching failed by the definition of diagrams/episodes/switching.py; a run whose disturbance
never came is not. The level decides no figure, only how well the climb is guided.
"""

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record
from diagrams.hybrid.perturbations import margin

DEFEATED = 1.0
JUST_WITHSTOOD = 0.999
# A normal run's largest error stands at half of gamma or above, whatever the disturbance; as power 3 that is 0.13, and
# comes before the other margins only near gamma.
NORMAL_POWER = 3


def severity(outcome: Outcome, record: Record, gamma: float) -> float:
    """DEFEATED, or less the farther the run was from it; 0 where the disturbance did not come.

    The larger of 1 - `margin` and of (error / gamma)^NORMAL_POWER, with the largest error of the ticks in which the
    network has the arm rightly: before the onset and after the resumption (false switch, switched again).

    `gamma`: the threshold of the record's errors.
    """
    if outcome.switch_failure is not None:
        return DEFEATED
    active = np.flatnonzero(record.active)
    if outcome.void or not len(active):
        return 0.0
    period = float(record.time[1] - record.time[0])
    worst, end = record.errors.max(axis=1), int(active[-1]) + 1
    assert outcome.return_s is not None  # it has returned and resumed, or it is a defeat
    assert outcome.resume_s is not None
    resumed = end + round((outcome.return_s + outcome.resume_s) / period)
    normal: np.ndarray = np.append(worst[: active[0]], worst[resumed:])
    largest = float(np.max(normal, initial=0.0)) / gamma
    near = max(1.0 - margin(outcome, record, len(active) * period, period, gamma), largest**NORMAL_POWER)
    return min(near, JUST_WITHSTOOD)
