"""The cycle: its arrows by hand, and the program on files."""

import json
import math

import pandas as pd
import pytest

from diagrams import analysis
from diagrams.episodes.store import RowStore
from diagrams.hybrid.common import fingerprint_with_analyses
from diagrams.hybrid.cycle import against, report, require_one_world, table
from diagrams.hybrid.cycle_sweep import DRAWN
from models.errors import InputError

PROVEN = {"samples": 50, "failed_or_touched": 0, "failures": 0, "left_box": 0, "touches": 0}
LQR_ALONE = {"samples": 40, "later_than_certified": 0, "max_v_increase": 0.0, "contraction_first_measured": 0.9,
             "contraction_first_over": -0.1, "contraction_rate_measured": 0.9}  # fmt: skip
RETURNED = {
    "seed": 0,
    "fingerprint": {"code": "1", "drake": "1.51", "world.resumption": "reset"},
    "level_at_home": 1.0 / math.e,
    "period_s": 0.1,
    "draws": 50,
    "draws_outside": 1,
    "draws_failed_or_touched": 0,
    "samples_inside": 300,
    "coverage_onsets": 1.0,
    "coverage_targets": 0.98,
    "sets": {
        kind: {"all": PROVEN, "free": LQR_ALONE, "contraction_first": 1.0, "contraction_rate": math.exp(-0.1),
               "nearest_distance_m": 0.009, "nearest_foot_m": 0.15, "v_tolerance": 0.0}
        for kind in ("box", "onsets", "targets")
    },
}  # fmt: skip


def entry(samples, not_resumed, finished, failures):
    return {
        "samples": samples,
        "not_resumed": not_resumed,
        "finished": {"samples": finished, "failures": failures},
    }


RESUMED = {
    "seed": 0,
    "fingerprint": {"code": "2", "drake": "1.51", "world.resumption": "reset"},
    "policy": "ours",
    "encoder_hash": "eyes",
    "by_scene": {"reset": {"samples": 200, "failures": 0}, "imagined": {"samples": 200, "failures": 90}},
    "finished_by_scene": {"samples": 30, "failures": 1},
    "rule": "reset",
    "rules": {
        "reset": {"pick": entry(1500, 0, 30, 0), "place": entry(1500, 0, 30, 1)},
        "imagined": {"pick": entry(1500, 700, 30, 9), "place": entry(1500, 300, 30, 9)},
    },
}


def row(disturbance, delay=0.2, returned=True, resumed=True, back=(3.0, 1.5), **others):
    disturbed = disturbance != "none"
    return {
        "weights_hash": "ours", "encoder_hash": "eyes", "way_home_m": 0.01, "way_home_nearest": "shelf",
        "detector": "recall", "gamma": None, "success": True, "error": None,
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
CALM = [one for one in ROWS if not (one["returned"] and one["resumed"] is False)]
OTHERS = (
    {"weights_hash": "another's"},
    {"encoder_hash": "other eyes"},
    {"detector": "knn"},
    {"gamma": 3.0},
    {"success": None},
)
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
        "reset and resumption": (0, 200),
        "subtask": (1, 30),
        "no later switch": (1, 10),
    }
    assert arrows["reset and resumption"]["bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 200))
    assert found["weakest"] == "no later switch"  # a tenth
    assert found["least_known"] == "no later switch"
    json.dumps(found)
    lines = table(found).splitlines()
    assert [line.split()[-1] for line in lines if "weakest" in line] == ["known"]
    assert "1 of 11 disturbed runs" in lines[-3]
    assert "0 of 11 disturbed runs (0 not home, 0 touch something, 0 of these the can to pick" in lines[-4]


def test_runs_that_no_arrow_counts_are_told():
    found = report(RETURNED, RESUMED, ROWS)
    assert found["switched_before"] == 1
    assert "left out: 1 disturbed runs with a false switch" in table(found)
    never = [one for one in ROWS if not one["false_switches"]]
    assert "left out" not in table(report(RETURNED, RESUMED, never))


def test_a_share_that_was_not_foretold_is_told():
    """2 of 12 did not resume, where 0 of 200 was foretold: of 212 with 2 failures both are these 12 with p 0.003."""
    found = report(RETURNED, RESUMED, [*ROWS, row("B", resumed=False)])["resumption"]
    assert (found["measured"]["failures"], found["measured"]["samples"]) == (2, 12)
    assert found["p"] == pytest.approx((12 * 11) / (212 * 211))
    assert found["agrees"] is False
    assert report(RETURNED, RESUMED, CALM)["resumption"]["agrees"] is True


@pytest.mark.parametrize(("lost", "agrees"), [(0, True), (1, True), (9, False)])
def test_runs_of_the_sweep_that_do_not_come_home_are_told(lost, agrees):
    """At most 5.8e-2 is foretold: 1 of 21 may be chance, 9 of 29 may not. Those not noticed were never on their way."""
    rows = [*CALM, *[row("A") for _ in range(10)], *[row("A", returned=False, resumed=False)] * lost]
    found = report(RETURNED, RESUMED, rows)["way_home"]
    assert found["foretold_bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 50))
    assert (found["measured"]["failures"], found["measured"]["samples"]) == (lost, 20 + lost)
    assert found["agrees"] is agrees


def test_a_way_of_the_sweep_that_touches_something_has_failed():
    own = row("A", way_home_m=-0.001, way_home_nearest="can_to_pick")
    found = report(RETURNED, RESUMED, [*CALM, *[row("A", way_home_m=0.0)] * 8, own])["way_home"]
    assert (found["measured"]["failures"], found["measured"]["touched"], found["measured"]["not_returned"]) == (9, 9, 0)
    assert found["measured"]["touched_can_to_pick"] == 1
    assert found["agrees"] is False


def test_what_speaks_against_the_cycle_is_told():
    found = report(RETURNED, RESUMED, [*ROWS, row("B", resumed=False)]) | {"certificate_holds": False}
    said = against(found)
    assert said[:2] == ["failures of the arrow 'guard'", "failures of the arrow 'return set'"]
    assert said[-2:] == [
        "the certificate of `return` does not hold", "what is foretold of 'resumption' fails more often in the sweep",
    ]  # fmt: skip
    calm = found | {"arrows": [], "certificate_holds": True, "resumption": {"agrees": None, "p": None}}
    assert against(calm) == ["what is foretold of 'resumption' is not seen in the sweep"]
    assert against(calm | {"resumption": {"agrees": True, "p": 1.0}}) == []


def test_of_no_runs_nothing_agrees():
    rows = [row("none"), *[row(kind, delay=None, returned=False, resumed=False, back=(None, None)) for kind in "AB"]]
    found = report(RETURNED, RESUMED, rows)
    assert (found["way_home"]["agrees"], found["resumption"]["agrees"]) == (None, None)
    arrows = {arrow["name"]: arrow for arrow in found["arrows"]}
    assert (arrows["no later switch"]["samples"], arrows["no later switch"]["bound"]) == (0, 1.0)


@pytest.mark.parametrize(
    "changed", [{"draws": 0}, {"draws": 10**400}, {"samples_inside": 0}, {"sets": RETURNED["sets"] | {
        "box": RETURNED["sets"]["box"] | {"contraction_first": 1e-9}}}],
)  # fmt: skip
def test_impossible_numbers_are_refused(changed):
    with pytest.raises(InputError, match="the reports do not fit"):
        report(RETURNED | changed, RESUMED, ROWS)


def test_negative_time_is_refused():
    with pytest.raises(InputError, match="return_s is -5"):
        report(RETURNED, RESUMED, [*ROWS, row("A", back=(-5.0, 1.0))])


def test_a_certificate_that_does_not_hold_is_told():
    assert report(RETURNED, RESUMED, ROWS)["certificate_holds"] is True
    touching = RETURNED["sets"]["onsets"] | {"all": PROVEN | {"touches": 1}}
    refuted = RETURNED | {"sets": RETURNED["sets"] | {"onsets": touching}}
    found = report(refuted, RESUMED, ROWS)
    assert found["certificate_holds"] is False
    assert "the certificate of `return` does not hold" in table(found)
    assert "does not hold" not in table(report(RETURNED, RESUMED, ROWS))


def test_dwell_time_by_hand():
    """mu = e and lambda = exp(-0.1): ten ticks, and the first, in which nothing is promised."""
    found = report(RETURNED, RESUMED, ROWS)["dwell"]
    assert found["mu"] == pytest.approx(math.e)
    assert found["bounds"]["box"]["ticks"] == pytest.approx(11.0)
    assert found["bounds"]["box"]["seconds"] == pytest.approx(1.1)
    assert found["measured_s"] == {"stays": 10, "min": 4.5, "median": 4.5, "max": 5.0}


@pytest.mark.parametrize("lacking", ["none", "A", "B"])
def test_a_sweep_without_the_network_or_a_disturbance_is_refused(lacking):
    """None of a void run either: its disturbance never came."""
    rows = [one | {"void": one["disturbance"] == lacking} for one in ROWS]
    with pytest.raises(InputError, match=rf"no episodes under {lacking} of the network.*--disturbance none A B"):
        report(RETURNED, RESUMED, rows)
    with pytest.raises(InputError, match="under none, A, B of the network"):
        report(RETURNED, RESUMED, [])


def test_an_episode_that_raised_an_error_is_no_good_one():
    with pytest.raises(InputError, match=r"1 episodes of the sweep raised an error: run it with --retry-errors"):
        report(RETURNED, RESUMED, [*ROWS, row("none", error="RuntimeError")])


def test_a_report_of_another_version_is_refused():
    with pytest.raises(InputError, match=r"do not fit \(return\.json has no draws\): run `return`"):
        report({name: value for name, value in RETURNED.items() if name != "draws"}, RESUMED, ROWS)


@pytest.mark.parametrize(
    ("returned", "resumed"),
    [({"level_at_home": None}, {}), ({"sets": 3}, {}), ({"sets": {"box": RETURNED["sets"]["box"]}}, {}),
     ({"draws": -1}, {}), ({}, {"rules": None}),
     ({}, {"rules": {"reset": {"pick": 5}}})],
)  # fmt: skip
def test_a_report_that_is_none_is_refused(returned, resumed):
    with pytest.raises(InputError, match="the reports do not fit"):
        report(RETURNED | returned, RESUMED | resumed, ROWS)


def test_reports_of_different_worlds_are_refused():
    first, second = RETURNED["fingerprint"], RESUMED["fingerprint"]
    require_one_world({"return": first, "resume": second})  # the code may differ
    with pytest.raises(InputError, match=r"return and resume differ in world\.resumption \(reset, imagined\)"):
        require_one_world({"return": first, "resume": second | {"world.resumption": "imagined"}})
    with pytest.raises(InputError, match=r"a report has no fingerprint"):
        require_one_world({"return": first, "resume": None})


def test_program(tmp_path, capsys, world):
    own = fingerprint_with_analyses(world)
    asked = ["cycle", "--out", str(tmp_path), "--sweep", str(tmp_path)]
    with pytest.raises(InputError, match=r"return\.json cannot be read: run `analysis\.py return --out"):
        analysis.main(analysis.parse(asked))
    for foreign in ("[1, 2]", "5", "null", "{", "{}"):
        (tmp_path / "return.json").write_text(foreign)
        with pytest.raises(InputError, match=r"return\.json cannot be read: run"):
            analysis.main(analysis.parse(asked))
    (tmp_path / "return.json").write_text(json.dumps(RETURNED | {"fingerprint": own | {"code": "1"}}))
    (tmp_path / "resume.json").write_text(json.dumps(RESUMED | {"fingerprint": own | {"code": "2"}}))
    with pytest.raises(InputError, match=r"return\.json is of the seed 0: give that as --seed, here 77"):
        analysis.main(analysis.parse([*asked, "--seed", "77"]))
    for foreign in ("", '{"fingerprint": 5}\n', "5\n"):
        (tmp_path / "rows.jsonl").write_text(foreign)
        with pytest.raises(InputError, match=r"rows\.jsonl is no sweep's: give the folder"):
            analysis.main(analysis.parse(asked))
    (tmp_path / "rows.jsonl").unlink()
    with RowStore(tmp_path / "rows.jsonl", own):
        pass
    (tmp_path / "soft.yaml").write_text("regulator: {input_weight: 45.0}\n")
    with pytest.raises(InputError, match=r"the world and return differ in .*regulator"):
        analysis.main(analysis.parse([*asked, "--world", str(tmp_path / "soft.yaml")]))
    with pytest.raises(InputError, match=r"summary\.json is no sweep's: give the folder"):
        analysis.main(analysis.parse(asked))
    for other in ({"purpose": "validation"}, {"way_home": "blocked"}):
        (tmp_path / "summary.json").write_text(json.dumps({"arguments": DRAWN | other}))
        with pytest.raises(InputError, match=r"is of --(purpose validation|way-home blocked): give a sweep of"):
            analysis.main(analysis.parse(asked))
    (tmp_path / "summary.json").write_text(json.dumps({"arguments": DRAWN}))
    with pytest.raises(InputError, match=r"there is no .*episodes\.parquet: give the folder"):
        analysis.main(analysis.parse(asked))
    (tmp_path / "episodes.parquet").write_text("cut short")
    with pytest.raises(InputError, match=r"episodes\.parquet cannot be read: run the sweep's command again"):
        analysis.main(analysis.parse(asked))
    pd.DataFrame([{"can_xy": [0.5, 0.0]} | one for one in CALM]).to_parquet(tmp_path / "episodes.parquet")
    assert analysis.main(analysis.parse(asked)) == 1  # some arrows have failures
    found = json.loads((tmp_path / "cycle.json").read_text())
    assert {"name", "samples", "failures", "bound"} <= found["arrows"][0].keys()
    assert (tmp_path / "cycle.png").is_file()
    assert (found["policy"], found["sweep"], found["codes"]["code"]["resume"]) == ("ours", str(tmp_path), "2")
    said = capsys.readouterr()
    assert "dwell time" in said.out
    assert "exit code 1: failures of the arrow" in said.out
    assert "warning: the reports differ in code: the world" in said.err
    (tmp_path / "return.json").write_text(json.dumps(RETURNED | {"fingerprint": own, "draws_outside": 0}))
    calm = RESUMED | {"fingerprint": own, "rules": {"reset": {"pick": entry(15, 0, 1, 0)}}}
    calm["finished_by_scene"] = {"samples": 1, "failures": 0}
    (tmp_path / "resume.json").write_text(json.dumps(calm))
    pd.DataFrame([row("none"), row("A"), row("B")]).to_parquet(tmp_path / "episodes.parquet")
    assert analysis.main(analysis.parse(asked)) == 0
