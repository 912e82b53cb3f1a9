"""Made-up episodes: an outcome, and a record with the ticks of a disturbance and the errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from diagrams.episodes.episode import Outcome

OUTCOME = Outcome(
    seed=1, rnn="lstm", detector="recall", disturbance="A", can_xy=(0.5, 0.0), vacant="left", picked=True, placed=True,
    home=True, void=False, way_home_clear=True, success=True, switched=True, detection_delay_s=0.2, guard_crossings=2,
    false_switches=0, later_switches=0, needless_s=0.0, returned=True, resumed=True, switch_success=True,
    paper_switch_success=True, alpha_max_before=0.0, return_s=2.0, resume_s=1.0, way_home_m=0.03,
    way_home_nearest="shelf", failure=None,
    switch_failure=None, sim_seconds=40.0, realtime_factor=5.0,
)  # fmt: skip


def outcome(job, success=True, **changes):
    """Of that job."""
    failure = None if success else "stalled"
    return replace(OUTCOME, seed=job.seed, disturbance=job.kind, success=success, failure=failure, **changes)


def record(normal, disturbed=(), active=0):
    """Errors (n, E) before the onset, and from it on, where the disturbance lasts for `active` ticks."""
    errors = np.array([*normal, *disturbed], float)
    ticks = np.arange(len(errors)) - len(normal)
    return SimpleNamespace(errors=errors, active=((ticks >= 0) & (ticks < active)).astype(float))
