"""Severity of made-up runs, by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.hybrid.severity import DEFEATED, JUST_WITHSTOOD, severity
from tests.diagrams.episode_fakes import OUTCOME

GAMMA = 10.0


def run(before=1.0, after=1.0, change=()):
    """Disturbed for 10 ticks from the fifth on, home after 2 s and resumed after another; far errors meanwhile."""
    errors = np.full((60, 3), 1.0)
    errors[:5], errors[5:45], errors[45:] = before, 1e4, after
    for tick, error in change:
        errors[tick] = error
    active = np.zeros(60)
    active[5:15] = 1.0
    return SimpleNamespace(
        errors=errors, active=active, alpha=(errors[:, 0] > GAMMA) * 1.0, time=0.1 * np.arange(60)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "normal", "level"),
    [
        ({}, {}, 0.2),  # noticed after 0.2 s of 1.0; resumed after 1 s of 6
        ({"resume_s": 3.0}, {}, 0.5),
        ({"detection_delay_s": 0.9}, {}, 0.9),
        ({}, {"before": 9.0}, 0.729),
        ({}, {"after": 9.0}, 0.729),
        ({"detection_delay_s": 1.0}, {}, JUST_WITHSTOOD),
        ({}, {"change": [(5, 10.1), (6, 11.0)]}, 0.2),  # its error rises
        ({}, {"change": [(20, 10.0 * 10.0**0.5)]}, 0.75),  # on the way home it falls to half a decade above gamma
        ({"switch_failure": "not resumed"}, {}, DEFEATED),
        ({"void": True}, {}, 0.0),
    ],
)
def test_severity_by_hand(change, normal, level):
    assert severity(replace(OUTCOME, **change), run(**normal), GAMMA) == pytest.approx(level)


@pytest.mark.parametrize(
    ("change", "normal", "level"),
    [
        ({}, {"before": 9.0, "after": 9.0}, 0.2),
        ({"switch_failure": "switched again"}, {}, 0.2),
        ({"switch_failure": "false switch"}, {}, 0.0),
        ({"switch_failure": "not resumed"}, {}, DEFEATED),
        ({"switch_failure": "simulation diverged"}, {}, DEFEATED),
    ],
)
def test_false_alarms_are_left_out_where_a_run_ends_with_the_resumption(change, normal, level):
    found = severity(replace(OUTCOME, **change), run(**normal), GAMMA, "as_paper")
    assert found == pytest.approx(level)


def test_a_run_whose_disturbance_never_came_is_no_defeat():
    record = run()
    record.active[:] = 0.0
    assert severity(replace(OUTCOME, void=True, return_s=None, resume_s=None), record, GAMMA) == 0.0
