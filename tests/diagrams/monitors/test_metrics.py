"""Metrics of monitors: scikit-learn to 1e-12, hand-worked cases, and intervals that are the sweep's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from sklearn.metrics import average_precision_score, balanced_accuracy_score, recall_score, roc_auc_score

from diagrams.monitors.metrics import (
    Monitored,
    area_under_precision,
    area_under_roc,
    contingency,
    labels,
    largest_scores,
    measured,
    of_median,
    severity_noticed_by_half,
    statistics,
)
from diagrams.sweeps.summary import bootstrap, rate

NAN = np.nan


def episodes(n, **columns):
    """Undisturbed episodes of 100 s that go well without an alarm, but for what is given."""
    plain = dict(
        scene=np.arange(n), training_seed=np.zeros(n, int), score=np.zeros(n), onset=np.full(n, NAN),
        alarm=np.full(n, NAN), false_alarms=np.zeros(n, int), normal_time=np.full(n, 100.0), length=np.full(n, 100.0),
        needed=np.zeros(n, bool), success=np.ones(n, bool), oracle_success=np.ones(n, bool), lost=np.zeros(n),
    )  # fmt: skip
    return Monitored(**plain | {name: np.asarray(value) for name, value in columns.items()})


# A miss, two alarms and a silence where the task fails; an alarm, a false alarm, a miss and a silence where it is done.
EIGHT = episodes(
    8,
    onset=[10.0, 10.0, 10.0, NAN, 10.0, 10.0, 10.0, NAN],
    alarm=[NAN, 20.0, 60.0, NAN, 12.0, NAN, NAN, NAN],
    false_alarms=[0, 0, 0, 0, 0, 1, 0, 0],
    needed=[True] * 4 + [False] * 4,
    success=[False, True, False, False, True, False, True, True],
    lost=[0.0, 0.0, 0.0, 0.0, 4.0, 8.0, 0.0, 0.0],
    score=[1.0, 5.0, 3.0, 2.0, 4.0, 2.0, 0.0, 1.0],
    oracle_success=[True, True, False, False, True, True, True, True],
    normal_time=[10.0, 10.0, 10.0, 100.0, 10.0, 10.0, 10.0, 100.0],
)


def test_labels_by_hand():
    assert labels(EIGHT).tolist() == [
        "harmful miss", "needed", "late", "harmful miss", "needless", "harmful", "harmless miss", "quiet",
    ]  # fmt: skip
    assert contingency(EIGHT) == {
        "undisturbed success": {"quiet": 1},
        "undisturbed failure": {"harmful miss": 1},
        "disturbed success": {"needless": 1, "harmful": 1, "harmless miss": 1},
        "disturbed failure": {"harmful miss": 1, "needed": 1, "late": 1},
    }


def test_all_by_hand():
    found = {name: entry and entry["value"] for name, entry in measured(EIGHT).items()}
    assert found == {
        "tasks": 4 / 8,
        "tpr": 2 / 4,
        "tnr": 2 / 4,
        "balanced_accuracy": 0.5,
        # Pairs: 5 beats all four, 3 beats 2, 0, 1, 2 beats 0 and 1 and ties with 2, 1 beats 0 and ties with 1.
        "auroc": (4 + 3 + 2.5 + 1.5) / 16,
        # Precision at 5: 1; 4: -; 3: 2/3; 2: 3/5; 1: 4/7; each gains a quarter of the recall.
        "auprc": pytest.approx((1 + 2 / 3 + 3 / 5 + 4 / 7) / 4),
        "twa": pytest.approx(0.5 * ((0.8 + 0.4) / 4 + 2 / 4)),
        "detection_s": 10.0,  # of 10, 50, 2
        "false_alarms_per_hour": pytest.approx(3600.0 / 260.0),
        "seconds_lost": 12.0 / 8,
        "net_benefit": 0.0,  # 4 with, 4 without
        "gap_closed": 0.0,  # of 6 - 4
    }


def test_a_false_alarm_under_way_at_the_onset_has_no_delay():
    given = episodes(3, onset=[10.0] * 3, alarm=[10.0, 14.0, NAN], false_alarms=[1, 0, 0])
    assert measured(given)["detection_s"]["value"] == 4.0


def test_no_false_alarm_in_so_many_hours_has_the_exact_bound():
    """Of Poisson's law: with 3.69 alarms expected there is none with a probability of 2.5 %."""
    found = measured(episodes(36))["false_alarms_per_hour"]  # an hour in all
    assert found == {"value": 0.0, "interval": [0.0, pytest.approx(chi2.ppf(0.975, 2) / 2)], "exact": True}


def test_a_perfect_detector_closes_the_gap():
    best = replace(EIGHT, success=EIGHT.oracle_success)
    found = measured(best)
    assert (found["net_benefit"]["value"], found["gap_closed"]["value"]) == (2 / 8, 1.0)


def test_by_disturbed_instead_of_needed():
    found = measured(EIGHT, of="disturbed")
    assert (found["tpr"]["value"], found["tnr"]["value"]) == (3 / 6, 1.0)
    assert found["tnr"]["exact"]
    assert not found["tpr"]["exact"]


def test_what_there_is_nothing_to_say_of_is_none():
    found = measured(episodes(3))
    none = {"tpr", "balanced_accuracy", "auroc", "auprc", "twa", "detection_s", "gap_closed"}
    assert {name for name, entry in found.items() if entry is None} == none
    assert set(measured(episodes(0)).values()) == {None}


def random_scores(draw_ties):
    values = st.integers(0, 5).map(float) if draw_ties else st.floats(-1e6, 1e6, allow_subnormal=False)
    return st.lists(st.tuples(values, st.booleans(), st.booleans()), min_size=2, max_size=60)


@pytest.mark.parametrize("ties", [True, False])
def test_areas_and_rates_are_scikit_learns(ties):
    @settings(max_examples=150, deadline=None)
    @given(random_scores(ties))
    def check(rows):
        score, needed, alarm = (np.array(column) for column in zip(*rows, strict=True))
        assume(0 < needed.sum() < len(needed))
        found = episodes(len(rows), score=score, needed=needed, alarm=np.where(alarm, 5.0, NAN))
        value = {name: float(of(np.ones(len(rows)))) for name, of in statistics(found).items()}
        assert value["auroc"] == pytest.approx(roc_auc_score(needed, score), abs=1e-12)
        assert value["auprc"] == pytest.approx(average_precision_score(needed, score), abs=1e-12)
        assert value["balanced_accuracy"] == pytest.approx(balanced_accuracy_score(needed, alarm), abs=1e-12)
        assert value["tpr"] == pytest.approx(recall_score(needed, alarm), abs=1e-12)
        assert value["tnr"] == pytest.approx(recall_score(~needed, ~alarm), abs=1e-12)

    check()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.booleans(), st.integers(0, 3)), min_size=2, max_size=30))
def test_a_weight_is_so_many_copies(rows):
    score, needed, weights = (np.array(column) for column in zip(*rows, strict=True))
    assume(needed[weights > 0].any() and not needed[weights > 0].all())
    copies = np.repeat(np.arange(len(rows)), weights)
    for area in (area_under_roc, area_under_precision):
        weighed = area(score.astype(float), needed, weights.astype(float))
        assert weighed == pytest.approx(area(score[copies].astype(float), needed[copies], np.ones(len(copies))))
    copied = of_median(score[copies].astype(float))(np.ones(len(copies)))
    assert of_median(score.astype(float))(weights.astype(float)) == copied


def test_intervals_are_those_of_the_sweep():
    rng = np.random.default_rng(0)
    scene = np.repeat(np.arange(40), 3)
    needed, alarm = np.ones(120, bool), np.where(rng.random(120) < 0.7, 1.0, NAN)
    found = measured(episodes(120, scene=scene, needed=needed, alarm=alarm))["tpr"]
    assert found["interval"] == pytest.approx(bootstrap(~np.isnan(alarm), scene))
    assert found["interval"][0] < found["value"] < found["interval"][1]
    all_seen = measured(episodes(120, scene=scene, needed=needed, alarm=np.ones(120)))["tpr"]
    assert all_seen["interval"] == rate(np.ones(120, bool), scene, np.zeros(120))["interval"]


def test_scores_are_cut_at_the_shortest_run():
    assert largest_scores([np.array([1.0, 2.0, 9.0]), np.array([3.0, 0.0])]).tolist() == [2.0, 3.0]


def test_severity_by_hand():
    # Shares noticed: 0, 0.25, 0.75, 1 at 0.2, 0.4, 0.6, 0.8: half at 0.5.
    severity = np.repeat([0.2, 0.4, 0.6, 0.8], 4)
    noticed = np.array([0, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1], bool)
    scene = np.tile(np.arange(4), 4)
    found = severity_noticed_by_half(severity, noticed, scene)
    assert found["value"] == pytest.approx(0.5)
    assert found["interval"][0] <= 0.5 <= found["interval"][1]
    # 0.5 and 0 at the first two are pooled to 0.25, which is below half.
    wobbling = np.array([1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1], bool)
    assert severity_noticed_by_half(severity, wobbling, scene)["value"] == pytest.approx(0.5)
    assert severity_noticed_by_half(severity, np.zeros(16, bool), scene) is None
    # In many draws of these scenes half is never noticed, which JSON has no number for.
    last = severity_noticed_by_half(severity, (severity == 0.8) & (scene < 2), scene)
    assert last == {"value": pytest.approx(0.8), "interval": [pytest.approx(0.7), None]}
    assert severity_noticed_by_half(severity, np.ones(16, bool), scene)["value"] == 0.2
