"""Rates, intervals, deviations and paired tests of a sweep, against hand-worked numbers and other libraries."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from diagrams.sweeps.summary import cells, comparisons, rate, sign_test, spread, table
from tests.diagrams.sweeps.rows import frame


@pytest.mark.parametrize(("successes", "n"), [(38, 40), (40, 40), (0, 40), (115, 120), (1, 1)])
def test_interval_is_wilsons(successes, n):
    found = rate(np.arange(n) < successes, np.zeros(n, int))
    z, p = 1.959963984540054, successes / n  # Wilson 1927, by hand
    middle, half = p + z**2 / (2 * n), z * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    assert found["interval"] == pytest.approx([(middle + s * half) / (1 + z**2 / n) for s in (-1, 1)], abs=1e-12)
    assert (found["n"], found["successes"], found["rate"]) == (n, successes, successes / n)


def test_mean_and_deviation_over_training_seeds_are_as_the_paper_gives_them():
    # 37, 39 and 39 of 40: the 95.8 +- 2.4 % of Table II.
    successes = np.concatenate([np.arange(40) < count for count in (37, 39, 39)])
    found = rate(successes, np.repeat([0, 1, 2], 40))
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
    assert (found["only_a"], found["only_b"]) == (12, 1)
    assert (found["scenes_a"], found["scenes_b"]) == (6, 1)
    assert found["p_scenes"] == pytest.approx(16 / 128)  # 2 (1 + 7) / 2^7, by hand


def test_comparison_is_mcnemars_exact_test_on_the_pairs():
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


def test_table_and_json_say_it_all():
    rows = pd.concat([frame("lstm", [1, 1, 1, 0]), frame("gru", [1, 0, 0, 0], gamma=3.0)])
    summary = {"cells": cells(rows), "comparisons": comparisons(rows)}
    text = table(summary)
    for words in ("LSTM recall", "GRU recall gamma 3", "3 of    4", "75.0 %", "stalled 3", "noticed after 0.2 s"):
        assert words in text
    json.dumps(summary)
