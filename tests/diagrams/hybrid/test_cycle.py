"""The cycle: its arrows by hand, and the program on files."""

import json
import math

import pandas as pd
import pytest

from diagrams import analysis
from diagrams.hybrid.cycle import report, table
from models.errors import InputError

PROVEN = {"samples": 100, "failures": 0, "touches": 0}
RETURNED = {
    "level_at_home": 1.0 / math.e,
    "draws": 50,
    "coverage_onsets": 1.0,
    "coverage_targets": 0.98,
    "sets": {
        kind: {"all": PROVEN, "contraction_rate": math.exp(-0.1), "time_home_certified_s": 1.0}
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
    "policy": "ours",
    "rule": "reset",
    "rules": {
        "reset": {"1": entry(1500, 0, 30, 0), "2": entry(1500, 0, 30, 1)},
        "imagined": {"1": entry(1500, 700, 30, 9), "2": entry(1500, 300, 30, 9)},
    },
}


def row(disturbance, delay=0.2, returned=True, resumed=True, back=(3.0, 1.5), **others):
    disturbed = disturbance != "none"
    return {
        "weights_hash": "ours", "detector": "recall", "disturbance": disturbance, "void": False, "false_switches": 0,
        "switched": disturbed, "detection_delay_s": delay if disturbed else math.nan,
        "returned": returned if disturbed else None, "resumed": resumed if disturbed else None,
        "return_s": back[0] if disturbed else math.nan, "resume_s": back[1] if disturbed and resumed else math.nan,
    } | others  # fmt: skip


ROWS = [row("none") for _ in range(20)] + [row("A") for _ in range(9)] + [row("B", delay=math.nan)]
ROWS += [row("B", resumed=False), row("A", back=(4.0, 1.0)), row("A", void=True), row("A", false_switches=1)]
ROWS += [row("B", weights_hash="another's", delay=math.nan), row("B", detector="knn", delay=math.nan)]


def test_arrows_by_hand():
    found = report(RETURNED, RESUMED, ROWS)
    arrows = {arrow["name"]: arrow for arrow in found["arrows"]}
    counts = {name: (arrow["failures"], arrow["samples"]) for name, arrow in arrows.items()}
    assert counts == {
        "no false alarm": (0, 20),
        "guard": (1, 12),
        "return set": (1, 100),
        "way home": (0, 300),
        "resumption": (0, 3000),
        "subtask": (1, 60),
    }
    assert arrows["resumption"]["bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 3000))
    assert found["weakest"] == "guard"
    assert found["all_bound"] == pytest.approx(sum(arrow["bound"] for arrow in found["arrows"]))
    json.dumps(found)
    text = table(found)
    assert "guard" in text
    assert "weakest" in text


def test_a_share_that_was_not_foretold_is_told():
    """1 of 12 did not resume, where at most 1e-3 was foretold: at 95 % it is at least 0.4 %."""
    found = report(RETURNED, RESUMED, ROWS)["resumption"]
    assert (found["measured"]["failures"], found["measured"]["samples"]) == (1, 12)
    assert found["agrees"] is False
    calm = [one for one in ROWS if one["resumed"] is not False]
    assert report(RETURNED, RESUMED, calm)["resumption"]["agrees"] is True


def test_dwell_time_by_hand():
    """mu = e and lambda = exp(-0.1): ten ticks."""
    found = report(RETURNED, RESUMED, ROWS)["dwell"]
    assert found["mu"] == pytest.approx(math.e)
    assert found["bounds"]["box"]["ticks"] == pytest.approx(10.0)
    assert found["measured_s"]["median"] == pytest.approx(4.5)
    assert found["measured_s"]["max"] == pytest.approx(5.0)


@pytest.mark.parametrize("rows", [[], ROWS[:20], ROWS[20:]])
def test_a_sweep_without_the_network_or_a_disturbance_is_refused(rows):
    with pytest.raises(InputError, match=r"no undisturbed, or no disturbed.*--disturbance none A B"):
        report(RETURNED, RESUMED, rows)


def test_a_report_of_another_version_is_refused():
    with pytest.raises(InputError, match=r"lack 'draws'.*run `return`"):
        report({name: value for name, value in RETURNED.items() if name != "draws"}, RESUMED, ROWS)


def test_program(tmp_path, capsys):
    asked = ["cycle", "--out", str(tmp_path), "--sweep", str(tmp_path)]
    with pytest.raises(InputError, match=r"return\.json cannot be read: run `analysis\.py return --out"):
        analysis.main(analysis.parse(asked))
    (tmp_path / "return.json").write_text(json.dumps(RETURNED))
    (tmp_path / "resume.json").write_text(json.dumps(RESUMED))
    with pytest.raises(InputError, match=r"there is no .*episodes\.parquet: give the folder"):
        analysis.main(analysis.parse(asked))
    pd.DataFrame([one for one in ROWS if one["resumed"] is not False]).to_parquet(tmp_path / "episodes.parquet")
    assert analysis.main(analysis.parse(asked)) == 0
    found = json.loads((tmp_path / "cycle.json").read_text())
    assert {"name", "samples", "failures", "bound"} <= found["arrows"][0].keys()
    assert (tmp_path / "cycle.png").is_file()
    assert "dwell time" in capsys.readouterr().out
