"""From what was seen in a run to its outcome."""

from dataclasses import replace
from typing import Any

import numpy as np

from diagrams.episodes.episode import DIVERGED, Episode, Outcome
from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD, Switching, Until
from diagrams.episodes.way_home import WayHome
from diagrams.world.task import TaskMonitor, lifted

# What has no meaning under a person's hands, several disturbances, or a fault that does not take the arm: there is no
# one disturbance by which it could be judged, or an alarm may be right that would count as false.
OF_ONE_DISTURBANCE = (
    "detection_delay_s", "false_switches", "later_switches", "needless_s", "returned", "resumed", "switch_success",
    "paper_switch_success", "alpha_max_before", "return_s", "resume_s", "switch_failure",
)  # fmt: skip


def make_outcome(
    episode: Episode,
    monitor: TaskMonitor,
    record: Record,
    switching: Switching,
    way_home: WayHome,
    success: bool,
    diverged: bool,
    begun: bool,
    period: float,
    policy_hash: str,
    posture: np.ndarray,
    until: Until = "task",
) -> Outcome:
    """What came of a run of `episode`, to its end or to what `until` says: see Outcome.

    `monitor`, `switching` and `way_home` have seen all of `record`; `diverged`: the simulation did; `begun`: what does
    not take the arm has begun, such as that the can was put elsewhere; `period`: of the ticks, s; `posture` (n, 8): as
    it was, which is that of `record` but where a sensor is wrong.
    """
    given = episode.disturbance
    came = not switching.void if given.takes_arm else begun or given.kind == "none"
    came |= bool(episode.hands) or not given.severity
    unjudged = bool(episode.hands) or given.several or (given.fault is not None and not given.takes_arm)
    void = not came and not diverged  # a run that diverged has failed at both
    switch_success, as_paper = switching.success, switching.as_paper
    failure, switch_failure = None, None if unjudged else switching.failure
    if diverged:
        switch_success = as_paper = False
        failed_before = switching.failed is not None and switch_failure is not None
        failure = switch_failure = switch_failure if failed_before else DIVERGED
    elif not success:
        failure, when = monitor.failure(record.can_poses, posture)
        failed = len(record.time) - 1 if switching.failed is None else switching.failed
        failure = switch_failure if switch_failure is not None and failed <= when else failure

    def seconds(a: int | None, b: int | None) -> float | None:
        return None if a is None or b is None else (b - a) * period

    outcome = Outcome(
        seed=episode.seed,
        rnn=episode.rnn,
        detector=episode.detector,
        disturbance=given.label,
        can_xy=(float(episode.can_xy[0]), float(episode.can_xy[1])),
        vacant=episode.vacant,
        picked=bool(lifted(record.can_poses).any()),
        placed=bool(monitor.placed(record.can_poses[-1])),
        home=bool(monitor.home(posture[-1])),
        void=void,
        way_home_clear=episode.way_home_clear,
        success=None if void else success,
        switched=bool((record.alpha >= GUARD).any()),
        detection_delay_s=seconds(switching.onset, switching.detected),
        guard_crossings=switching.crossings,
        false_switches=switching.false_switches,
        later_switches=switching.later_switches,
        needless_s=switching.needless_ticks * period,
        returned=switching.home is not None if switching.disturbed else None,
        resumed=switching.resumed is not None if switching.disturbed else None,
        switch_success=switch_success,
        paper_switch_success=as_paper,
        alpha_max_before=switching.alpha_max_before,
        return_s=seconds(switching.end, switching.home),
        resume_s=seconds(switching.home, switching.resumed),
        way_home_m=way_home.nearest,
        way_home_nearest=way_home.name,
        failure=failure,
        switch_failure=switch_failure,
        sim_seconds=len(record.time) * period,
        weights_hash=policy_hash,
        severity=None if given.fault is None else given.severity,
        recovery=episode.recovery,
    )
    if until != "task":  # what was cut short is not judged
        outcome.success = None
        outcome.failure = outcome.failure if diverged else None
        outcome.switch_success = outcome.switch_success if until == "switching" else None
        outcome.paper_switch_success = outcome.paper_switch_success if until == "as_paper" else None
    nothing: dict[str, Any] = dict.fromkeys(OF_ONE_DISTURBANCE)
    return replace(outcome, **nothing) if unjudged else outcome
