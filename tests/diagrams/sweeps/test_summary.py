"""Rates, intervals, deviations and paired tests of a sweep, against hand-worked numbers and other libraries."""

import json

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from diagrams.sweeps.summary import MEASURES, cells, comparisons, rate, sign_test, spread, table
from tests.diagrams.sweeps.rows import frame


def of_scenes(successes, seeds=1):
    """Rate of (scenes, training seeds) bool."""
    successes = np.asarray(successes).reshape(-1, seeds)
    scenes, training = np.indices(successes.shape)
    return rate(successes.ravel().astype(bool), scenes.ravel(), training.ravel())


@pytest.mark.parametrize("lost", [3, 10, 20])
def test_interval_of_one_training_seed_is_scipys_bootstrap(lost):
    successes = np.arange(40) >= lost
    theirs = scipy.stats.bootstrap(
        (successes.astype(float),), np.mean, n_resamples=20_000, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    found = of_scenes(successes)
    assert found["interval"] == pytest.approx([theirs.low, theirs.high], abs=0.026)  # one scene of 40
    assert (found["n"], found["successes"], found["rate"], found["exact"]) == (40, 40 - lost, 1 - lost / 40, False)


def test_scenes_that_are_alike_under_all_training_seeds_are_no_more_scenes():
    one = np.arange(40) >= 10
    width = {
        seeds: np.diff(of_scenes(np.repeat(one[:, None], seeds, axis=1), seeds)["interval"])[0] for seeds in (1, 3)
    }
    assert width[3] == pytest.approx(width[1], abs=0.03)
    # Where the scene decides nothing, three times the runs make it narrower: by 1 / sqrt(3), were scenes drawn alone.
    mixed = np.random.default_rng(0).permutation(np.repeat(one, 3))
    assert np.diff(of_scenes(mixed, 3)["interval"])[0] < 0.85 * width[1]


def test_interval_by_hand():
    """Two scenes, one training seed, one success: the rate of a draw is 0, 1/2 or 1 with 1/4, 1/2, 1/4."""
    assert of_scenes([True, False])["interval"] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("successes", "bounds"), [(True, (0.025 ** (1 / 40), 1.0)), (False, (0.0, 1 - 0.025 ** (1 / 40)))]
)
def test_all_or_none_have_the_exact_interval_of_the_scenes(successes, bounds):
    found = of_scenes(np.full((40, 3), successes), 3)
    assert found["exact"]
    assert found["interval"] == found["scenes"]["interval"] == pytest.approx(bounds)


def test_a_scene_is_right_where_each_training_seed_is():
    found = of_scenes([[1, 1, 1], [1, 0, 1], [1, 1, 1], [0, 0, 0]], 3)
    assert (found["successes"], found["scenes"]["n"], found["scenes"]["all_right"]) == (8, 4, 2)
    assert of_scenes([]) == {"n": 0, "successes": 0}


def test_mean_and_deviation_over_training_seeds_are_as_the_paper_gives_them():
    # 37, 39 and 39 of 40: the 95.8 +- 2.4 % of Table II.
    successes = np.column_stack([np.arange(40) < count for count in (37, 39, 39)])
    found = of_scenes(successes, 3)
    assert found["by_training_seed"] == {"0": 0.925, "1": 0.975, "2": 0.975}
    assert (round(100 * found["mean"], 1), round(100 * found["deviation"], 1)) == (95.8, 2.4)


def test_spread_leaves_out_what_never_came():
    assert spread(pd.Series([1.0, None, 3.0])) == {"median": 2.0, "p95": pytest.approx(2.9), "n": 2}
    assert spread(pd.Series([None, None], dtype=float)) is None


def test_cells_pool_the_training_seeds_and_nothing_else():
    rows = pd.concat(
        [
            frame("lstm", [1, 1, 1, 0]),
            frame("lstm", [1, 1, 0, 0], training_seed=1),
            frame("lstm", [0, 0, 0, 0], gamma=3.0),
            frame("gru", [1, 1, 1, 1]),
        ]
    )
    found = cells(rows)
    assert [(c["rnn"], c["gamma"], c["task"]["n"], c["task"]["successes"]) for c in found] == [
        ("lstm", None, 8, 5), ("lstm", 3.0, 4, 0), ("gru", None, 4, 4),
    ]  # fmt: skip
    assert found[0]["task"]["by_training_seed"] == {"0": 0.75, "1": 0.5}
    assert found[0]["task"]["failures"] == {"stalled": 3}
    assert found[0]["switching"]["failures"] == {"not resumed": 3}
    assert found[0]["return_s"]["median"] == pytest.approx(2.0)
    assert found[0]["resume_s"] is None


def test_rows_without_a_recovery_are_of_the_one_that_ships():
    rows = [frame("lstm", [True] * 4).assign(recovery=name) for name in (None, "planned", "backoff")]
    found = cells(pd.concat([frame("lstm", [False] * 2), *rows]))
    assert [(cell["recovery"], cell["task"]["n"]) for cell in found] == [("planned", 10), ("backoff", 4)]


def test_false_alarms_under_way_at_the_onset_are_no_fast_detections():
    rows = frame("lstm", [1, 1, 1, 0])
    rows.loc[3, ["false_switches", "detection_delay_s"]] = [1, 0.0]
    assert cells(rows)[0]["detection_delay_s"] == {"median": 0.2, "p95": 0.2, "n": 3}


def test_scenes_that_recur_under_every_training_seed_count_once():
    # Scenes 0 to 5 are lost by the second under both training seeds, scene 6 is won by it once; scene 7 is a draw.
    first = [frame("lstm", [1] * 6 + [0, 1], training_seed=s) for s in (0, 1)]
    second = [
        frame("lstm", [0] * 6 + [won, drawn], detector="knn", training_seed=s)
        for s, won, drawn in ((0, 1, 1), (1, 0, 1))
    ]
    found = comparisons(pd.concat(first + second))[0]
    assert (found["n"], found["only_a"], found["only_b"]) == (16, 12, 1)
    assert (found["scenes"], found["scenes_a"], found["scenes_b"]) == (8, 6, 1)
    assert found["p"] == pytest.approx(16 / 128)  # 2 (1 + 7) / 2^7, by hand


def test_comparisons_are_of_every_measure_whatever_the_order_of_the_rows():
    a = np.array([1] * 30 + [1] * 9 + [0] * 1)
    b = np.array([1] * 30 + [0] * 9 + [1] * 1)
    rows = pd.concat([frame("lstm", a), frame("lstm", b, detector="knn").sample(frac=1.0, random_state=0)])
    found = comparisons(rows)
    assert [c["measure"] for c in found] == ["task", "switching", "as_paper"]
    assert (found[0]["n"], found[0]["only_a"], found[0]["only_b"]) == (40, 9, 1)
    assert found[0]["p"] == pytest.approx(22 / 1024)  # 2 (1 + 10) / 2^10, by hand


@pytest.mark.parametrize(("a", "b", "p"), [(0, 0, 1.0), (5, 5, 1.0), (0, 5, 2 / 32), (5, 0, 2 / 32), (1, 3, 10 / 16)])
def test_sign_test_by_hand(a, b, p):
    assert sign_test(a, b) == pytest.approx(p)


def test_controllers_that_never_differ_have_p_1():
    rows = pd.concat([frame("lstm", [1, 0, 1]), frame("gru", [1, 0, 1])])
    assert {c["p"] for c in comparisons(rows)} == {1.0}


def test_pairs_are_of_one_disturbance_training_seed_and_gamma():
    rows = pd.concat(
        [
            frame("lstm", [1, 1]),
            frame("lstm", [1, 1], gamma=3.0),
            frame("gru", [0, 1], training_seed=1),
            frame("gru", [0, 1, 1], disturbance="B"),
        ]
    )
    assert [(c["n"], c["p"]) for c in comparisons(rows)] == [(0, 1.0)] * 3


def test_the_paper_s_words_are_counted_apart_with_what_failed_there():
    rows = frame("lstm", [1, 1, 0, 0]).assign(paper_switch_success=[True, True, True, False])
    found = cells(rows)[0]
    assert (found["switching"]["successes"], found["as_paper"]["successes"]) == (2, 3)
    assert (found["switching"]["failures"], found["as_paper"]["failures"]) == ({"not resumed": 2}, {"not resumed": 1})


def test_what_was_not_asked_for_is_no_failure():
    rows = pd.concat([frame("lstm", [1, 1, 0]), frame("gru", [1, 0, 0])])
    rows = rows.assign(success=None, failure=None, paper_switch_success=None)
    assert ["task" in cell for cell in cells(rows)] == [False, False]
    assert [c["measure"] for c in comparisons(rows)] == ["switching"]
    assert "2 of    3" in table({"cells": cells(rows), "comparisons": comparisons(rows)})


def test_void_episodes_are_counted_apart():
    rows = frame("lstm", [1, 1, 1, 0])
    # The disturbance of the last two never came: one stalled before, one after a false alarm, which is a failure.
    rows["void"] = [False, False, True, True]
    for name in ("success", "switch_success", "paper_switch_success"):
        rows[name] = [True, False, None, None]
    rows.loc[3, "switch_success"] = False
    rows["failure"] = [None, "can toppled", "stalled", "false switch"]
    rows["switch_failure"] = [None, "not returned", None, "false switch"]
    rows["guard_crossings"] = [2, 4, 0, 9]
    found = cells(rows)[0]
    assert (found["void"], found["void_failures"]) == (2, {"stalled": 1, "false switch": 1})
    assert [(found[name]["n"], found[name]["successes"]) for name in MEASURES] == [(2, 1), (3, 1), (2, 1)]
    assert found["switching"]["failures"] == {"not returned": 1, "false switch": 1}
    assert (found["one_return"]["n"], found["one_return"]["successes"]) == (2, 1)
    text = table({"cells": [found], "comparisons": []})
    assert "void, since the disturbance never came: 2 (stalled 1, false switch 1)" in text
    # Against another controller the episodes count that say something under both.
    other = frame("gru", [1, 1, 1, 1])
    assert [c["n"] for c in comparisons(pd.concat([rows, other]))] == [2, 3, 2]
    rows["success"] = None
    assert "switching" in cells(rows.iloc[2:])[0]
    assert cells(rows.iloc[2:3].assign(switch_success=None, paper_switch_success=None))[0].get("task") is None


def test_episodes_whose_way_home_is_clear_are_also_counted_apart():
    rows = frame("lstm", [1, 1, 1, 0, 0]).assign(way_home_clear=[True, True, True, True, False])
    found = cells(rows)[0]
    assert (found["task"]["n"], found["task"]["clear"]["n"], found["task"]["clear"]["successes"]) == (5, 4, 3)
    assert found["switching"]["clear"]["failures"] == {"not resumed": 1}
    assert "way home clear     3 of    4" in table({"cells": [found], "comparisons": []})
    assert "clear" not in cells(frame("lstm", [1, 0]))[0]["task"]


def test_returns_that_no_disturbance_explains():
    rows = frame("lstm", [1, 1, 1, 1]).assign(
        guard_crossings=[2, 2, 3, 0], later_switches=[0, 0, 1, 0], needless_s=[0.0, 0.4, 0.4, 0.0]
    )
    found = cells(rows)[0]
    assert (found["one_return"]["successes"], found["one_return"]["n"]) == (3, 4)
    assert found["needless_share"] == pytest.approx(0.8 / 160)
    assert found["switched_again"] == 1
    assert "needless returns: 0.50 % of the time; switched again in 1 runs" in table(
        {"cells": [found], "comparisons": []}
    )
    for kind in ("none", "moved"):
        assert "one_return" not in cells(rows.assign(disturbance=kind))[0]


def test_what_touches_something_on_its_way_home_is_counted():
    rows = frame("lstm", [1, 1, 1, 1, 1]).assign(way_home_m=[0.02, 0.012, 0.0, -0.004, np.nan])
    found = cells(rows)[0]
    assert (found["untouched"]["successes"], found["untouched"]["n"]) == (2, 4)  # the fifth went no way home
    assert found["way_home_m"] == -0.004
    assert "touches nothing    2 of    4" in table({"cells": [found], "comparisons": []})
    assert "nearest -0.4 cm" in table({"cells": [found], "comparisons": []})
    assert cells(frame("lstm", [1, 1]))[0]["way_home_m"] is None


def test_an_episode_that_raised_is_a_failure():
    rows = frame("lstm", [1, 1, 1])
    raised = {"success": False, "switch_success": False, "paper_switch_success": False, "failure": "error"}
    rows.loc[2, [*raised, "error"]] = [*raised.values(), "RuntimeError: the arm fell off"]
    rows.loc[2, ["guard_crossings", "needless_s", "sim_seconds"]] = None
    found = cells(rows)[0]
    assert (found["errors"], found["task"]["n"], found["task"]["failures"]) == (1, 3, {"error": 1})
    assert (found["one_return"]["n"], found["needless_share"]) == (2, 0.0)
    assert "task" in cells(rows.iloc[2:])[0]  # also where all raised


def test_table_and_json_say_it_all():
    rows = pd.concat([frame("lstm", [1, 1, 1, 0]), frame("gru", [1, 0, 0, 0], gamma=3.0)])
    summary = {"cells": cells(rows), "comparisons": comparisons(rows)}
    text = table(summary)
    for words in ("LSTM recall", "GRU recall gamma 3", "3 of    4", "75.0 %", "stalled 3", "noticed after 0.2 s"):
        assert words in text
    json.dumps(summary)
    assert "100.0]e" in table({"cells": cells(frame("lstm", [1, 1])), "comparisons": []})


def test_severities_of_a_fault_are_cells_of_their_own_and_alarms_are_counted():
    unjudged = {"switch_success": None, "paper_switch_success": None, "returned": None, "false_switches": None}
    rows = pd.concat(
        frame("lstm", [1, 1, 0, 1], disturbance="camera_shift").assign(severity=s, switched=switched, **unjudged)
        for s, switched in ((0.5, [False] * 4), (1.0, [True, True, True, False]))
    )
    weak, strong = cells(rows)
    assert (weak["severity"], strong["severity"]) == (0.5, 1.0)
    assert (weak["alarmed"]["successes"], strong["alarmed"]["successes"]) == (0, 3)
    assert not {"switching", "one_return"} & strong.keys()
    text = table({"cells": [weak, strong], "comparisons": []})
    assert "camera_shift 0.5 task " in text
    assert "alarm              3 of    4" in text
    assert cells(frame("lstm", [1, 1]))[0]["severity"] is None
    assert "alarmed" not in cells(frame("lstm", [1, 1]))[0]
