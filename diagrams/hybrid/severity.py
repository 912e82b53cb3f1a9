"""Severity: how near a disturbed run came to a defeat, the level that splitting climbs.

Defeated means that the switching failed by the definition of diagrams/episodes/switching.py; a run whose disturbance
never came is not. Of runs that end with the resumption only what lies between onset and resumption counts: false
alarms before and after come without a disturbance too. The level decides no figure, only how well the climb is guided.
"""

from collections.abc import Sequence

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD, RESUME_SECONDS, Until
from diagrams.world.names import ARM_JOINTS

DEFEATED = 1.0
JUST_WITHSTOOD = 0.999
# A normal run's largest error stands at half of gamma or above, whatever the disturbance; as power 3 that is 0.13, and
# comes before the other margins only near gamma.
NORMAL_POWER = 3
DECADES = 2.0  # an error so many powers of ten from the threshold has the whole margin


def severity(outcome: Outcome, record: Record, gamma: float, until: Until = "task") -> float:
    """DEFEATED, or less the farther the run was from it; 0 where the disturbance did not come.

    The larger of 1 - `margin` and of (error / gamma)^NORMAL_POWER, with the largest error of the ticks in which the
    network has the arm rightly: before the onset and after the resumption (false switch, switched again).

    `gamma`: the threshold of the record's errors; `until`: what the run ended with, "task" or "as_paper", which leaves
    out the errors and a false switch before the onset (0: the arm was on its way home when it was disturbed).
    """
    failed, alarms_count = outcome.switch_failure, until == "task"
    if failed == "false switch" and not alarms_count:
        return 0.0
    if failed is not None and (failed != "switched again" or alarms_count):
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
    largest = float(np.max(normal, initial=0.0)) / gamma if alarms_count else 0.0
    near = max(1.0 - margin(outcome, record, len(active) * period, period, gamma), largest**NORMAL_POWER)
    return min(near, JUST_WITHSTOOD)


def margin(outcome: Outcome, record: Record, seconds: float, period: float, gamma: float) -> float:
    """How far a run is from a defeat, in [0, 1].

    `seconds`: how long it is disturbed; `period`: of the ticks, s; `gamma`: threshold of the errors.
    """
    margins = [1.0]
    active = np.flatnonzero(record.active)
    if len(active):
        worst = record.errors.max(axis=1)
        margins.append(_decades(worst[active[0] : active[-1] + 1].max(), gamma))
        # How near the recall came to fitting again before the arm was at home; where its error rises, it is near gamma
        # without any danger.
        if outcome.returned and outcome.return_s is not None:
            home = active[-1] + 1 + round(outcome.return_s / period)
            away = np.flatnonzero(record.alpha[: home + 1] >= GUARD)
            first = int(away[away >= active[0]][0])
            led = worst[first : home + 1]
            margins.append(_decades(led[led.argmax() :].min(), gamma))
    if outcome.detection_delay_s is not None:
        margins.append(1.0 - outcome.detection_delay_s / seconds)
    if outcome.resume_s is not None:
        margins.append(1.0 - outcome.resume_s / RESUME_SECONDS)
    return float(np.clip(min(margins), 0.0, 1.0))


def moved_deg(target: Sequence[float] | None, record: Record) -> float:
    """Norm over the joints of the move to `target` (7, rad) from the command at the onset, deg; 0 without either."""
    active = np.flatnonzero(record.active)
    if target is None or not len(active) or active[0] == 0:
        return 0.0
    return float(np.rad2deg(np.linalg.norm(np.array(target) - record.desired_posture[active[0] - 1, :ARM_JOINTS])))


def _decades(error: float, gamma: float) -> float:
    return float(abs(np.log10(max(error, 1e-12) / gamma)) / DECADES)
