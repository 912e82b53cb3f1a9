"""The probability of defeat: its report, and the program on a controller that notices nothing."""

import json
from dataclasses import asdict, replace
from functools import partialmethod

import numpy as np
import pytest

from diagrams import analysis
from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.store import RowStore
from diagrams.hybrid import defeat
from diagrams.hybrid.defeat_cases import Case, Cases
from diagrams.hybrid.defeat_report import clusters, features, terciles
from diagrams.hybrid.splitting import Splitting, Stage
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import load_scenario
from models.errors import InputError
from models.files.weights import load_policy, save_policy
from tests.diagrams.episode_fakes import OUTCOME


def case(seed=0, kind="B", level=0.5, failure=None, done=True, subtask=2, begins=0.06, hold=15, moved=None, deg=0.0):
    target = [0.0] * 7 if kind == "A" else None
    given = DisturbanceSpec(kind, begins, target, 10 if kind == "A" else hold, subtask, moved)
    episode = Episode(seed, (0.5, 0.0), "left", given, way_home_clear=True)
    return Case(episode, 1.0 if failure else level, failure, done, False, deg, 400, 100, f"hash {seed}")


def run(estimate, weights, evaluations=4):
    return Splitting(estimate, [Stage(0.5, 0.3, 0.4)], evaluations, estimate == 0.0, 0.01, weights)


LOST = case(1, failure="not resumed", done=False)
WITHSTOOD, TOPPLED = case(2), case(3, done=False)


def test_report_by_hand():
    cases = [WITHSTOOD, LOST, TOPPLED, None]
    runs = [run(0.9, []), run(0.02, [(0, 0.9), (1, 0.02), (2, 0.08)]), run(0.02, [(0, 0.8), (1, 0.02), (2, 0.18)])]
    brute = [LOST, *[case(10 + i) for i in range(99)]]
    found = defeat.report(runs, [cases] * 3, [WITHSTOOD, LOST, TOPPLED], brute, 4, 1)
    assert found["estimate"] == pytest.approx(0.02)  # the pilot's is not used
    assert found["task"]["estimate"] == pytest.approx(0.15)
    assert (found["episodes"], found["evaluations"], found["defeats_found"]) == (3, 12, 1)
    assert found["without_episode"] == 3
    assert list(found["by_failure"]) == ["not resumed"]  # of the weights 0.02 and 0.02
    assert found["by_failure"]["not resumed"]["estimate"] == pytest.approx(0.02)
    assert found["ticks"] == {"all": 1200, "saved": 300}
    assert found["brute"]["estimate"] == 0.01
    assert (found["overlap"], found["brute"]["task"]["estimate"]) == (True, 0.01)
    assert len(found["repetitions"]) == 2
    [above] = found["above"]  # the level 0.5, which 2 of the 8 of the repetitions and one case of brute force pass
    assert (above["level"], above["estimate"], above["brute"]["estimate"]) == (0.5, 0.25, 0.01)
    assert above["interval"] == pytest.approx([0.0319, 0.6509], abs=1e-4)  # Clopper and Pearson
    assert (above["evaluations"], above["overlap"]) == (12, True)
    assert defeat.report(runs, [cases] * 3, [LOST], [LOST] * 50, 4, 1)["overlap"] is False
    alone = defeat.report(runs, [cases] * 3, [LOST], [], 4, 1)
    assert (alone["overlap"], alone["above"][0]["brute"], alone["above"][0]["overlap"]) == (None, None, None)
    assert "brute" not in defeat.words("B", alone)
    text = defeat.words("B", found)
    assert "2.00e-02" in text
    assert "25% of their ticks saved" in text
    assert "beyond the level 0.500 2.50e-01 [3.19e-02, 6.51e-01] by 12 episodes, by brute force 1.00e-02" in text
    assert text.count("intervals overlap") == 2
    json.dumps(found)


def test_levels_beside_brute_force_by_hand():
    """Of 40 points in two repetitions 8 pass the first level, a fifth and a tenth of these the second."""
    stages = [[Stage(0.3, 0.2, 0.4), Stage(0.6, share, 0.4)] for share in (0.2, 0.2, 0.1)]
    runs = [Splitting(0.0, own, 60, True, 0.001, []) for own in stages]
    brute = [case(i, level=0.7 if i < 50 else 0.5) for i in range(100)]
    found = defeat.report(runs, [[WITHSTOOD]] * 3, [WITHSTOOD], brute, 20, 1)
    first, second = found["above"]
    assert (first["estimate"], first["evaluations"], first["brute"]["estimate"]) == (0.2, 60, 1.0)
    assert (second["estimate"], second["evaluations"], second["brute"]["estimate"]) == (pytest.approx(0.03), 120, 0.5)
    assert (first["overlap"], second["overlap"]) == (False, True)  # two repetitions say little of the second
    assert defeat.compared(found) is second  # 0.03 is nearer to 1e-2 than 0.2
    assert "beyond the level 0.600 3.00e-02" in defeat.words("A", found)
    assert defeat.compared(defeat.report(runs, [[WITHSTOOD]] * 3, [WITHSTOOD], [], 20, 1)) is None


def test_report_of_runs_that_end_with_the_resumption():
    """Their tasks are not judged, and false alarms that they had count nowhere."""
    cases = [replace(c, task_done=None) for c in (LOST, replace(WITHSTOOD, failure="switched again"))]
    found = defeat.report([run(0.02, [(0, 0.02), (1, 0.98)])] * 3, [cases] * 3, cases, cases * 50, 2, 1)
    assert (found["task"], found["brute"]["task"], list(found["by_failure"])) == (None, None, ["not resumed"])
    assert found["brute"]["estimate"] == 0.5
    assert "task" not in defeat.words("A", found)


def test_what_defeats_have_in_common_by_hand():
    far = dict(failure="not resumed", begins=0.155)
    defeats = [case(1, **far), case(2, **far), case(3, **far, hold=25), case(4, failure="switched again", subtask=1)]
    found = clusters(defeats, [*defeats, *(case(10 + i, subtask=1, begins=0.11) for i in range(4))])
    first = found["clusters"][0]
    assert (first["defeats"], first["example"]) == (2, 0)
    assert first["words"] == (
        "not resumed, subtask 2, begun far from the goal, way home clear, left spot vacant, short stop, can left"
    )
    common = {entry["what"]: entry for entry in found["common"]}
    assert common["subtask"] == {"what": "subtask", "value": "subtask 2", "share": 0.75, "share_of_all": 0.375}
    assert common["failure"]["share_of_all"] is None
    assert clusters([], []) == {"clusters": [], "common": []}


def test_features_by_hand():
    sizes = terciles([case(kind="A", deg=d) for d in (10.0, 40.0, 70.0, 100.0)])
    assert sizes == pytest.approx([40.0, 70.0])
    words = [features(case(kind="A", deg=d), sizes)["size"] for d in (20.0, 50.0, 90.0)]
    assert words == ["small move", "middling move", "large move"]
    words = [features(case(hold=h), sizes)["hold"] for h in (15, 20, 25)]
    assert words == ["short stop", "middling stop", "long stop"]
    assert features(case(moved=[0.5, 0.0]), sizes)["can"] == "can taken"


class _Pool:
    """Counts the jobs."""

    def __init__(self):
        self.jobs = []

    def run(self, function, jobs):
        for job in jobs:
            self.jobs.append(job)
            yield job, replace(LOST, episode=job[0].episode)


class _Bar:
    def update(self):
        pass


def test_an_episode_is_run_once_also_after_a_restart(tmp_path, world):
    episodes = [LOST.episode, WITHSTOOD.episode, LOST.episode]
    for new in (2, 0):
        pool, job = _Pool(), defeat.Job(world, tmp_path, None)
        with RowStore(tmp_path / "rows.jsonl", {}) as store:
            found = Cases(job, 1.0, True, store, pool).run(episodes, _Bar())
        assert len(pool.jobs) == new
        assert [entry.episode for entry in found] == episodes
        assert all(isinstance(entry.episode.can_xy, tuple) for entry in found)
    assert Case.of_row(json.loads(json.dumps(asdict(LOST)))) == LOST


def test_a_case_of_a_run_by_hand():
    active = np.zeros(30)
    active[5:15] = 1.0
    record = type("R", (), {})()
    record.active, record.time, record.alpha = active, 0.1 * np.arange(30), active
    record.errors, record.desired_posture = np.ones((30, 2)), np.zeros((30, 8))
    import diagrams.hybrid.defeat_cases as module

    patched = pytest.MonkeyPatch()
    patched.setattr(module, "record_hash", lambda record: "hash")
    outcome = replace(OUTCOME, switch_failure="not returned", success=False)
    episode = replace(LOST.episode, disturbance=DisturbanceSpec("A", 0.1, [0.3, 0.4, 0, 0, 0, 0, 0], 2))
    found = Case.of(episode, outcome, record, 7, 1.0)
    patched.undo()
    assert found.moved_deg == pytest.approx(np.rad2deg(0.5))
    assert (found.level, found.failure, found.task_done, found.saved, found.ticks) == (
        1.0,
        "not returned",
        False,
        7,
        30,
    )


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        (["--kinds", "none"], "--kinds none is no choice of A and B"),
        (["--kinds", "A", "A"], "--kinds A A is no choice"),
        (["--kept", "1.5"], r"--kept 1\.5 is no share"),
        (["--population", "2"], "--population 2 is too small"),
        (["--moves", "0"], "--moves 0 is too small"),
        (["--repetitions", "1"], "--repetitions 1 is too small: choose 2 or more"),
        (["--brute", "-1"], "--brute -1 is too small"),
        (["--brute", "20000"], "--brute 20000 is too large: choose at most 10000"),
    ],
)
def test_bad_input_is_named(tmp_path, asked, named, monkeypatch):
    monkeypatch.setattr(defeat.Climb, "run", lambda *_: run(0.1, []))
    with pytest.raises(InputError, match=named):
        analysis.main(analysis.parse(["defeat", "--out", str(tmp_path), "--workers", "0", *asked]))


@pytest.mark.parametrize("until", ["task", "resumption"])
def test_a_blind_controller_is_defeated_by_everything(tmp_path, monkeypatch, until):
    """The shipped network with a threshold that nothing reaches, in runs too short for the task."""
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=1.0))
    monkeypatch.setattr(defeat, "EpisodeSpace", lambda *given: _Early(*given))
    weights, out = tmp_path / "weights", tmp_path / "out"
    weights.mkdir()
    (weights / "encoder.onnx").symlink_to(WEIGHTS.resolve() / "encoder.onnx")
    save_policy(weights / "lstm.onnx", replace(load_policy(WEIGHTS / "lstm.onnx"), gamma=1e9))
    asked = ["--weights", str(weights), "--out", str(out), "--kinds", "B", "--population", "4", "--kept", "0.5"]
    asked += ["--repetitions", "2", "--workers", "0", "--until", until]
    assert analysis.main(analysis.parse(["defeat", *asked])) == 0
    found = json.loads((out / "defeat.json").read_text())["kinds"]["B"]
    assert (found["estimate"], found["interval"], found["overlap"]) == (1.0, [1.0, 1.0], None)
    assert len(found["counterexamples"]) == found["episodes"] == 12
    assert (out / "defeat.png").is_file()
    assert (found["task"] is None) == (until == "resumption")
    assert load_scenario(out / found["clusters"][0]["file"]).disturbance.kind == "B"
    rows, stale = (out / "defeat_cases.jsonl").read_bytes(), out / "defeat-B-9.yaml"
    stale.write_text("of an earlier run")
    assert analysis.main(analysis.parse(["defeat", *asked])) == 0  # nothing is run again
    assert (out / "defeat_cases.jsonl").read_bytes() == rows
    again = json.loads((out / "defeat.json").read_text())
    assert again["kinds"]["B"] == found
    assert again["policy"] == again["fingerprint"]["weights"]
    assert not stale.exists()


class _Early:
    """Arms that are stopped at once."""

    size, blocks = 3, {"scene": np.array([0]), "moment": np.array([1]), "hold": np.array([2])}

    def __init__(self, world, kind, rnn):
        self._given = kind, rnn

    def episode(self, point):
        given = DisturbanceSpec("B", 5.0 + abs(float(point[1])), None, 2, 1)
        return Episode(0, (0.55, -0.04), "left", given, self._given[1])
