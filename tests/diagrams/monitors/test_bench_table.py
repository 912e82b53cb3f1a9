"""Labels and cells of the bench against rows that were worked out by hand."""

import pytest

from diagrams.episodes.calibration import Calibration
from diagrams.monitors.bench_plan import BenchArguments, in_loop
from diagrams.monitors.bench_table import POOLED, cells, pooled, records, text, worth
from diagrams.monitors.bench_task import BenchTask, Scored
from diagrams.monitors.families import FAMILIES, family_of
from diagrams.world.configuration import World
from diagrams.world.faults.registry import FAULTS

MINE, ORACLE, NEVER = (Scored(name, Calibration((1.0,), 30.0, 1.0), name) for name in ("speed", "oracle", "never"))
ALL = NEVER, ORACLE, MINE
WORLD = World()


def episode(kind, seed, never, alarm=None, false_alarms=0, onset=100, ticks=400, peak=0.5, **changes):
    """A run with the detector off, and its row; `never`: whether the task is done."""
    task = BenchTask("off", WORLD, "lstm", 0, kind, None if kind in ("none", "A") else 1.0, seed, "w", ALL)
    onset = None if kind == "none" else onset

    def said(alarm, false_alarms, peak):
        return {"alarm": alarm, "false_alarms": false_alarms, "peaks": [(0, 0.0), (150, peak)]}

    told = None if onset is None else onset + 1
    scores = {"never": said(None, 0, 0.0), "oracle": said(told, 0, 1.0), "speed": said(alarm, false_alarms, peak)}
    row = {"success": never, "void": False, "error": None, "onset": onset, "ticks": ticks, "detectors": scores}
    return task, row | changes


# The episode with `never`; in the loop the detector, with its seconds, and the oracle; the label.
WORKED = [
    (episode("none", 1, True), None, None, "quiet"),
    (episode("none", 2, True, alarm=50, false_alarms=1, peak=2.0), (True, 45.0), None, "needless"),
    (episode("A", 1, False, alarm=110, peak=3.0), (True, 50.0), True, "needed"),
    (episode("A", 2, False, alarm=180, peak=2.0), (False, 60.0), True, "late"),
    (episode("A", 3, False), None, False, "harmful miss"),
    (episode("payload", 1, True), None, True, "harmless miss"),
    (episode("payload", 2, True, alarm=105, peak=1.0), (False, 60.0), True, "harmful"),
    (episode("payload", 3, True, alarm=120, peak=4.0), (True, 42.5), False, "needless"),
]


@pytest.fixture(scope="module")
def found():
    off, loops, rows = [], [], {}
    arguments = BenchArguments(recoveries=["hold"])
    for (task, row), own, oracle, _ in WORKED:
        off.append(task)
        rows[task.key] = row
        for loop in in_loop(arguments, task, row):
            acts = own if loop.detectors == (MINE,) else (oracle, 55.0)
            rows[loop.key] = {"success": acts[0], "sim_seconds": acts[1], "error": None}
            loops.append(loop)
    assert len(loops) == 5 + 6
    return records(off, loops, rows, ["hold"], 0.1)


def test_labels(found):
    mine = [record["label"] for record in found if record["detector"] == "speed"]
    assert mine == [label for *_, label in WORKED]
    assert [r["lost_s"] for r in found if r["detector"] == "speed"] == [0, pytest.approx(5.0), 0, 0, 0, 0, 0,
                                                                      pytest.approx(2.5)]  # fmt: skip
    counted = next(w for w in worth(found) if (w["detector"], w["fault"]) == ("speed", "A"))["labels"]
    assert counted["disturbed failure"] == {"needed": 1, "late": 1, "harmful miss": 1}
    assert not counted["disturbed success"]


def test_a_detector_that_does_not_act_has_what_is_noticed_alone(found):
    """Cells, labels and table; all else is as where it acts, the oracle stays, and without it nobody's gap is known."""
    off, rows = [task for (task, _), *_ in WORKED], {task.key: row for (task, row), *_ in WORKED}
    arguments = BenchArguments(detectors=["speed"], recoveries=["hold"], loop=["never"])
    assert not [loop for (task, row), *_ in WORKED for loop in in_loop(arguments, task, row)]
    alone = records(off, [], rows, ["hold"], 0.1, arguments.acting)
    for cell, whole in zip(cells(alone), cells(found), strict=True):
        unknown = {"gap_closed"}
        if cell["detector"] != "never":
            unknown |= {"tasks", "seconds_lost", "net_benefit"}
        assert {name for name in unknown if cell[name] is not None} == set()
        assert {n: v for n, v in cell.items() if n not in unknown} == {
            n: v for n, v in whole.items() if n not in unknown
        }
    assert {entry["detector"]: entry["labels"] is None for entry in worth(alone)} == {
        "never": False, "oracle": True, "speed": True,
    }  # fmt: skip
    words = text({"cells": cells(alone), "pooled": pooled(alone)})
    # With all faults, and with what is noticed; not among the tasks done.
    assert [line.split()[0] for line in words.splitlines() if line].count("speed") == 2
    acting = BenchArguments(detectors=["speed"], recoveries=["hold"], loop=["speed"])
    assert acting.acting == {"never", "oracle", "speed"}


def values(cell):
    return {name: entry["value"] for name, entry in cell.items() if isinstance(entry, dict) and "value" in entry}


def test_a_cell_by_hand(found):
    cell = next(c for c in cells(found) if (c["detector"], c["fault"]) == ("speed", "A"))
    assert (cell["severity"], cell["recovery"], cell["n"]) == (None, "hold", 3)
    assert values(cell) == {
        "tasks": pytest.approx(1 / 3),
        "tpr": pytest.approx(2 / 3),
        "tnr": 1 / 2,  # of the undisturbed
        "balanced_accuracy": pytest.approx((2 / 3 + 1 / 2) / 2),
        "auroc": pytest.approx((2 + 1.5 + 0.5) / 6),  # 3.0, 2.0 and 0.5 against 2.0 and 0.5
        "auprc": pytest.approx(1 / 3 * (1 + 2 / 3 + 3 / 5)),
        "twa": pytest.approx(0.5 * ((1 - 11 / 40 + 1 - 18 / 40) / 3 + 1 / 2)),
        "detection_s": pytest.approx(1.0),
        "false_alarms_per_hour": pytest.approx(3600 / 110),  # 1 in 3 times 10 s and 2 times 40 s
        "seconds_lost": 0.0,
        "net_benefit": pytest.approx(1 / 3),
        "gap_closed": pytest.approx(1 / 2),
    }


def test_the_fault_noticed_by_hand(found):
    """Not whether an alarm was needed, but whether there was a fault."""
    payload = next(c for c in cells(found) if (c["detector"], c["fault"]) == ("speed", "payload"))
    assert values(payload["disturbed"]) == {
        "tpr": pytest.approx(2 / 3),
        "tnr": 1 / 2,
        "balanced_accuracy": pytest.approx((2 / 3 + 1 / 2) / 2),
        "auroc": pytest.approx((0.5 + 1 + 2) / 6),  # 0.5, 1.0 and 4.0 against 2.0 and 0.5
        "auprc": pytest.approx(1 / 3 * (1 + 2 / 3 + 3 / 5)),
        "twa": pytest.approx(0.5 * ((1 - 105 / 400 + 1 - 12 / 40) / 3 + 1 / 2)),
    }
    assert payload["tpr"] is None  # none of these was needed


def test_families():
    by_name = {name: family_of(name) for name in ("A", "B", "camera_shift", "can_moved", "joint_offset", "push_hand")}
    assert [FAMILIES.index(family) for family in by_name.values()] == [0, 0, 1, 1, 0, 0]
    assert {family_of(name) for name in FAULTS} == set(FAMILIES)


def test_never_and_oracle_by_hand(found):
    by = {(c["detector"], c["fault"]): values(c) for c in cells(found)}
    assert (by["never", "payload"]["tasks"], by["never", "payload"]["net_benefit"]) == (1.0, 0.0)
    assert (by["oracle", "A"]["net_benefit"], by["oracle", "A"]["gap_closed"]) == (pytest.approx(2 / 3), 1.0)
    assert by["oracle", "payload"]["net_benefit"] == pytest.approx(-1 / 3)


def test_pooled_are_all_faults(found):
    arm, cell = (
        next(c for c in pooled(found) if (c["detector"], c["fault"]) == ("speed", name))
        for name in (FAMILIES[0], POOLED)
    )
    assert {name: value for name, value in arm.items() if name != "fault"} == {  # all of these are the arm's
        name: value for name, value in cell.items() if name != "fault"
    }
    assert {c["fault"] for c in pooled(found)} == {POOLED, FAMILIES[0]}
    assert (cell["fault"], cell["n"]) == ("pooled", 6)
    assert values(cell)["tasks"] == pytest.approx(3 / 6)
    assert values(cell)["tnr"] == pytest.approx(2 / 5)  # of what needs no alarm: three of the payload, two undisturbed
    assert values(cell)["seconds_lost"] == pytest.approx(2.5 / 6)
    assert values(cell)["gap_closed"] == 0.0  # 1 task more, 1 less: none won; with the oracle 1 more


def test_what_was_void_or_raised_an_error_counts_nowhere():
    (task, row), (other, error) = episode("A", 1, None, void=True), episode("A", 2, False, alarm=120)
    rows = {task.key: row, other.key: error}
    arguments = BenchArguments(recoveries=["hold"])
    assert not list(in_loop(arguments, task, row))
    loops = list(in_loop(arguments, other, error))
    rows |= {loop.key: {"error": "RuntimeError"} if loop.detectors == (MINE,) else
             {"success": True, "sim_seconds": 50.0, "error": None} for loop in loops}  # fmt: skip
    left = records([task, other], loops, rows, ["hold"], 0.1)
    assert [(record["seed"], record["detector"]) for record in left] == [(2, "never"), (2, "oracle")]
