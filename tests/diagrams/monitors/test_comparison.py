"""Two of the bench compared: by hand, where it stops, and that a kill or runs from before change nothing."""

import json

import pytest

from diagrams import bench
from diagrams.episodes.calibration import never_fires
from diagrams.monitors.bench_plan import BenchArguments
from diagrams.monitors.bench_task import BenchTask, Scored, error_row
from diagrams.monitors.comparison import comparison_text, comparisons, looks, rounds
from diagrams.sweeps.sequential import evidence
from diagrams.world.scenario import load_world
from models.errors import InputError
from tests.diagrams import bench_fakes
from tests.diagrams.untrained import save_untrained

TWO = ("recall", "planned"), ("never", "planned")


def episodes(kinds, scenes, stage="off", label="recall", training_seeds=(0,)):
    world, scored = load_world(None), Scored(label, never_fires(1), "h")
    return [
        BenchTask(stage, world, "lstm", training_seed, kind, severity, seed, "w", (scored,))
        for kind, severity in kinds
        for seed in range(scenes)
        for training_seed in training_seeds
    ]


def row(success, **more):
    return {"success": success, "error": None, "void": False, "sim_seconds": 1.0} | more


def test_a_fault_that_is_decided_goes_no_further():
    """A: the recall does each task and never none, decided at the second look; payload at 0.5: both do all."""
    kinds = [("A", None), ("payload", 0.5)]
    off, loops = episodes(kinds, 10), episodes(kinds, 10, "loop")
    rows = {task.key: row(task.kind != "A") for task in off}
    for some in rounds(TWO, off, loops, rows, loops):
        rows |= {task.key: row(True) for task in some}
    assert [sum(task.key in rows and task.kind == kind for task in loops) for kind, _ in kinds] == [8, 10]
    made = [task for some in looks(TWO, off, loops, rows) for task in some]
    assert [sum(task.kind == kind for task in made) for kind, _ in kinds] == [8, 10]
    assert not any(rounds(TWO, off, loops, rows, [task for task in loops if task.key not in rows]))
    # What an earlier bench has run beyond is not looked at.
    rows |= {task.key: row(False) for task in loops if task.key not in rows}
    assert [task for some in looks(TWO, off, loops, rows) for task in some] == made


def test_void_episodes_errors_and_silence():
    """Seven of eight scenes say something; without an alarm the run with the detector off is the detector's too."""
    off, loops = episodes([("A", None)], 12), episodes([("A", None)], 12, "loop")
    rows = {task.key: row(False) for task in off} | {task.key: row(True) for task in loops}
    assert sum(map(len, looks(TWO, off, loops, rows))) == 8
    rows[loops[0].key] = error_row(loops[0], RuntimeError("x"))
    assert sum(map(len, looks(TWO, off, loops, rows))) == 8  # 7 to none
    rows[off[1].key]["void"] = True
    assert [len(some) for some in looks(TWO, off, loops, rows)] == [4, 4, 4]  # 6 to none, then 10
    rows[off[1].key]["void"] = False
    assert sum(map(len, looks(TWO, off, loops[2:], rows))) == 12  # scene 1 did not alarm: 6 to none after eight
    rows |= {task.key: row(True) for task in off[:2]}
    assert sum(map(len, looks(TWO, off, loops[2:], rows))) == 12  # and even where never does it


def test_scenes_are_pairs_and_training_seeds_within_them():
    off = episodes([("A", None)], 8, training_seeds=(0, 1))
    loops = episodes([("A", None)], 8, "loop", training_seeds=(0, 1))
    rows = {task.key: row(task.training_seed == 1) for task in off}
    rows |= {task.key: row(task.training_seed == 0) for task in loops}  # one more, one less
    assert sum(map(len, looks(TWO, off, loops, rows))) == 16
    rows |= {task.key: row(True) for task in loops}
    assert [len(some) for some in looks(TWO, off, loops, rows)] == [8, 8]


def record(detector, fault, seed, success, training_seed=0, severity=None):
    return {
        "detector": detector, "recovery": "planned", "fault": fault, "severity": severity, "seed": seed,
        "training_seed": training_seed, "success": success,
    }  # fmt: skip


def test_comparisons_by_hand():
    """Under A the recall wins scenes 0 and 1, under payload it loses 1 and 2: over both, 0 against 2, 1 is even."""
    won = {("A", 0): 1, ("A", 1): 1, ("A", 2): 0, ("payload", 0): 0, ("payload", 1): -1, ("payload", 2): -1}
    found = [record("recall", fault, seed, d >= 0) for (fault, seed), d in won.items()]
    found += [record("never", fault, seed, d <= 0) for (fault, seed), d in won.items()]
    found += [record("recall", "none", 0, True), record("never", "none", 0, False)]
    found += [record("speed", "A", 0, None)]  # does not act
    by = {c["fault"]: c for c in comparisons(found)}
    assert list(by) == ["A", "payload", "none", "pooled"]
    assert by["A"]["a"] == {"detector": "recall", "recovery": "planned"}
    assert by["A"]["b"] == {"detector": "never", "recovery": "planned"}
    counts = {
        fault: [c[name] for name in ("n", "only_a", "only_b", "scenes", "scenes_a", "scenes_b")]
        for fault, c in by.items()
    }
    assert counts == {
        "A": [3, 2, 0, 3, 2, 0], "payload": [3, 0, 2, 3, 0, 2],
        "none": [1, 1, 0, 1, 1, 0], "pooled": [6, 2, 2, 3, 1, 1],
    }  # fmt: skip
    assert by["A"]["e"] == pytest.approx(1.5)
    assert "pooled: recall (planned) against never (planned): of 3 scenes 1 and 1; e = 0.5" in comparison_text(
        [*by.values()]
    )
    assert comparisons(found, TWO) == comparisons(found)[:-1]  # of a stopped bench none is over all


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


def arguments(weights, out, **changes):
    given = dict(
        detectors=["recall", "speed"], faults=["A", "payload"], episodes=12, fit_runs=4, calibration_runs=3,
        weights=weights, workers=0, out=out, loop=["recall"], stop_when_decided=True,
    )  # fmt: skip
    return BenchArguments(**given | changes)


def fake(folder, task):
    """Under A the recall does all and never none; under payload it is chance."""
    found = bench_fakes.bench_row(folder, task)
    return found | {"success": task.stage == "loop"} if task.kind == "A" else found


def test_the_bench_stops_and_stays_stopped(weights, tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(bench, "run_bench_task", lambda folder, task: asked.append(task) or fake(folder, task))
    assert bench.main(arguments(weights, tmp_path)) == 0
    loops = [task for task in asked if task.stage == "loop"]
    assert {task.detectors[0].label for task in loops} == {"recall"}
    assert sum(task.kind == "A" for task in loops) == 8
    assert "A: recall (planned) against never (planned): of 8 scenes 8 and 0; decided, e = " in capsys.readouterr().out
    found = json.loads((tmp_path / "summary.json").read_text())
    assert {c["n"] for c in found["cells"] if c["fault"] == "A"} == {8}
    [entry] = [c for c in found["comparisons"] if c["fault"] == "A"]
    assert entry["e"] == pytest.approx(float(evidence(8, 8)))
    assert {c["gap_closed"] for c in found["pooled"]} == {None}
    asked.clear()
    before = (tmp_path / "summary.json").read_bytes()
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert not asked
    assert (tmp_path / "summary.json").read_bytes() == before
    # All runs, then again what stops.
    assert bench.main(arguments(weights, tmp_path, stop_when_decided=False)) == 0
    assert {task.detectors[0].label for task in asked} == {"recall", "oracle"}
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert (tmp_path / "summary.json").read_bytes() == before


def test_an_error_beyond_the_stop_counts_nowhere(weights, tmp_path, monkeypatch):
    """Scenes 0 and 9 err, and A is decided at the third look; later 0 does not, and A is decided before 9."""
    broken = {0, 9}

    def failing(folder, task):
        if task.stage == "loop" and task.seed % 100 in broken:
            return error_row(task, RuntimeError("the arm fell off"))
        return fake(folder, task)

    monkeypatch.setattr(bench, "run_bench_task", failing)
    asked = arguments(weights, tmp_path, faults=["A"], detectors=["recall"])
    monkeypatch.setattr("diagrams.monitors.comparison.DECIDED", 30.0)  # 8 to none
    assert bench.main(asked) == 1
    broken.clear()
    broken.add(9)
    assert bench.main(asked) == 0
    assert json.loads((tmp_path / "summary.json").read_text())["errors"] == 0


def test_killed_in_the_loop_it_ends_as_one_that_was_left_alone(weights, tmp_path, monkeypatch):
    def dying(folder, task):
        if task.stage == "loop" and left_to_live.pop() == 0:
            raise KeyboardInterrupt
        return fake(folder, task)

    left_to_live = [*range(100)]
    monkeypatch.setattr(bench, "run_bench_task", dying)
    assert bench.main(arguments(weights, tmp_path / "whole")) == 0
    left_to_live = [*range(6)]
    with pytest.raises(KeyboardInterrupt):
        bench.main(arguments(weights, tmp_path / "killed"))
    left_to_live = [*range(100)]
    assert bench.main(arguments(weights, tmp_path / "killed")) == 0
    for name in ("summary.json", "bench.parquet", "explorer.html"):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "killed" / name).read_bytes()


def test_two_recoveries_or_two_detectors_are_two(weights, tmp_path):
    given = arguments(weights, tmp_path)
    assert given.compared == (("recall", "planned"), ("never", "planned"))
    assert arguments(weights, tmp_path, recoveries=["planned", "hold"]).compared == (
        ("recall", "planned"), ("recall", "hold"),
    )  # fmt: skip
    assert arguments(weights, tmp_path, loop=["oracle", "recall"]).compared[0] == ("oracle", "planned")


@pytest.mark.parametrize(
    "changes",
    [
        {"loop": None},
        {"loop": None, "detectors": ["recall"]},
        {"loop": ["never"]},
        {"loop": ["recall", "speed"], "recoveries": ["planned", "hold"]},
    ],
)
def test_what_is_no_pair_is_refused(weights, tmp_path, changes):
    with pytest.raises(
        InputError, match=r"--stop-when-decided compares two that act in the closed loop, here [0-9]+: "
    ):
        bench.main(arguments(weights, tmp_path, **changes))
    assert not [*tmp_path.iterdir()]
