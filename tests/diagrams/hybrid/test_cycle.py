"""The cycle: its arrows by hand, and the program on files."""

import json
import math

import pandas as pd
import pytest

from diagrams import analysis
from diagrams.episodes.store import RowStore
from diagrams.hybrid.cycle import report, require_one_world, table
from models.errors import InputError

PROVEN = {"samples": 50, "failed_or_touched": 0}
RETURNED = {
    "fingerprint": {"code": "1", "drake": "1.51", "world.resumption": "reset"},
    "level_at_home": 1.0 / math.e,
    "period_s": 0.1,
    "draws": 50,
    "samples_inside": 300,
    "coverage_onsets": 1.0,
    "coverage_targets": 0.98,
    "sets": {
        kind: {"all": PROVEN, "contraction_first": 1.0, "contraction_rate": math.exp(-0.1)}
        for kind in ("box", "onsets", "targets")
    },
}


def entry(samples, not_resumed, finished, failures):
    return {
        "samples": samples,
        "not_resumed": not_resumed,
        "finished": {"samples": finished, "failures": failures},
    }


RESUMED = {
    "fingerprint": {"code": "2", "drake": "1.51", "world.resumption": "reset"},
    "policy": "ours",
    "rule": "reset",
    "rules": {
        "reset": {"pick": entry(1500, 0, 30, 0), "place": entry(1500, 0, 30, 1)},
        "imagined": {"pick": entry(1500, 700, 30, 9), "place": entry(1500, 300, 30, 9)},
    },
}


def row(disturbance, delay=0.2, returned=True, resumed=True, back=(3.0, 1.5), **others):
    disturbed = disturbance != "none"
    return {
        "weights_hash": "ours", "detector": "recall", "gamma": None, "success": True, "error": None,
        "disturbance": disturbance, "void": False, "false_switches": 0, "later_switches": 0, "switched": disturbed,
        "detection_delay_s": delay if disturbed else None,
        "returned": returned if disturbed else None, "resumed": resumed if disturbed else None,
        "return_s": back[0] if disturbed else None, "resume_s": back[1] if disturbed and resumed else None,
    } | others  # fmt: skip


ROWS = [row("none") for _ in range(20)] + [row("A") for _ in range(8)] + [row("A", later_switches=1)]
ROWS += [row("B", delay=None, returned=False, resumed=False, back=(None, None))]
ROWS += [
    row("B", resumed=False),
    row("A", back=(4.0, 1.0)),
    row("A", void=True, success=None),
    row("A", false_switches=1),
]
OTHERS = {"weights_hash": "another's"}, {"detector": "knn"}, {"gamma": 3.0}, {"success": None}
ROWS += [row("B", delay=None, **others) for others in OTHERS]


def test_arrows_by_hand():
    found = report(RETURNED, RESUMED, ROWS)
    arrows = {arrow["name"]: arrow for arrow in found["arrows"]}
    counts = {name: (arrow["failures"], arrow["samples"]) for name, arrow in arrows.items()}
    assert counts == {
        "no false alarm": (0, 20),
        "guard": (1, 12),
        "return set": (1, 50),
        "way home": (0, 50),
        "way home, anywhere in the box": (0, 300),
        "reset and resumption": (0, 3000),
        "subtask": (1, 60),
        "no later switch": (1, 10),
    }
    assert arrows["reset and resumption"]["bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 3000))
    assert found["weakest"] == "no later switch"  # a tenth
    assert found["least_known"] == "no later switch"
    json.dumps(found)
    lines = table(found).splitlines()
    assert [line.split()[-1] for line in lines if "weakest" in line] == ["known"]
    assert "1 of 11 disturbed runs" in lines[-2]


def test_a_share_that_was_not_foretold_is_told():
    """1 of 11 did not resume, where at most 1e-3 was foretold: at 95 % it is at least 0.5 %."""
    found = report(RETURNED, RESUMED, ROWS)["resumption"]
    assert (found["measured"]["failures"], found["measured"]["samples"]) == (1, 11)
    assert found["measured"]["at_least"] == pytest.approx(1.0 - 0.95 ** (1.0 / 11))
    assert found["agrees"] is False
    calm = [one for one in ROWS if not (one["returned"] and one["resumed"] is False)]
    assert report(RETURNED, RESUMED, calm)["resumption"]["agrees"] is True


def test_dwell_time_by_hand():
    """mu = e and lambda = exp(-0.1): ten ticks, and the first, in which nothing is promised."""
    found = report(RETURNED, RESUMED, ROWS)["dwell"]
    assert found["mu"] == pytest.approx(math.e)
    assert found["bounds"]["box"]["ticks"] == pytest.approx(11.0)
    assert found["bounds"]["box"]["seconds"] == pytest.approx(1.1)
    assert found["measured_s"] == {"stays": 10, "min": 4.5, "median": 4.5, "max": 5.0}


@pytest.mark.parametrize("rows", [[], ROWS[:20], ROWS[20:]])
def test_a_sweep_without_the_network_or_a_disturbance_is_refused(rows):
    with pytest.raises(InputError, match=r"no undisturbed, or no disturbed.*--disturbance none A B"):
        report(RETURNED, RESUMED, rows)


def test_an_episode_that_raised_an_error_is_no_good_one():
    with pytest.raises(InputError, match=r"1 episodes of the sweep raised an error: run it with --retry-errors"):
        report(RETURNED, RESUMED, [*ROWS, row("none", error="RuntimeError")])


def test_a_report_of_another_version_is_refused():
    with pytest.raises(InputError, match=r"lack 'draws'.*run `return`"):
        report({name: value for name, value in RETURNED.items() if name != "draws"}, RESUMED, ROWS)


def test_reports_of_different_worlds_are_refused():
    first, second = RETURNED["fingerprint"], RESUMED["fingerprint"]
    require_one_world({"return": first, "resume": second})  # the code may differ
    with pytest.raises(InputError, match=r"return and resume differ in world\.resumption \(reset, imagined\)"):
        require_one_world({"return": first, "resume": second | {"world.resumption": "imagined"}})
    with pytest.raises(InputError, match=r"a report has no fingerprint"):
        require_one_world({"return": first, "resume": None})


def test_program(tmp_path, capsys):
    asked = ["cycle", "--out", str(tmp_path), "--sweep", str(tmp_path)]
    with pytest.raises(InputError, match=r"return\.json cannot be read: run `analysis\.py return --out"):
        analysis.main(analysis.parse(asked))
    (tmp_path / "return.json").write_text(json.dumps(RETURNED))
    (tmp_path / "resume.json").write_text(json.dumps(RESUMED))
    with pytest.raises(InputError, match=r"rows\.jsonl is no sweep's: give the folder"):
        analysis.main(analysis.parse(asked))
    with RowStore(tmp_path / "rows.jsonl", RETURNED["fingerprint"]):
        pass
    with pytest.raises(InputError, match=r"there is no .*episodes\.parquet: give the folder"):
        analysis.main(analysis.parse(asked))
    calm = [one for one in ROWS if not (one["returned"] and one["resumed"] is False)]
    pd.DataFrame([{"can_xy": [0.5, 0.0]} | one for one in calm]).to_parquet(tmp_path / "episodes.parquet")
    assert analysis.main(analysis.parse(asked)) == 0
    found = json.loads((tmp_path / "cycle.json").read_text())
    assert {"name", "samples", "failures", "bound"} <= found["arrows"][0].keys()
    assert (tmp_path / "cycle.png").is_file()
    assert "dwell time" in capsys.readouterr().out
