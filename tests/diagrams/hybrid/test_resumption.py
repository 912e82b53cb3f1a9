"""The region of resumption: the report by hand, T against the whole system, and the program."""

import json
from dataclasses import replace

import numpy as np
import pytest

from diagrams import analysis
from diagrams.episodes.calibration import Controller, stored_calibration
from diagrams.episodes.runner import Job, build_rollout
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.hybrid.resumption import Resume, SceneJob, run_disturbed, run_scene, worst_ticks
from diagrams.hybrid.resumption_report import Row, RunRow, finished_by_scene, judge, judge_runs, words_of_runs
from diagrams.hybrid.resumption_starts import KINDS, Memory, Resumptions, Start
from diagrams.hybrid.resumption_time import time_to_resume
from diagrams.hybrid.return_proof import bound
from diagrams.world.configuration import RESUMPTIONS, World
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.task import HOME_TOLERANCE, lifted
from models.data.scaling import MinMaxScaling
from models.errors import InputError
from models.inference import Policy
from tests.diagrams.untrained import save_untrained

HORIZON = 2


def row(foretold, resumed, done=None, scene=0, left=0, rule="reset", kind="pick"):
    return Row(scene, rule, kind, left, foretold, resumed, done)


def test_judge_by_hand():
    """Of five starts one failed that was foretold to take 40 ticks, and one that was foretold to fail did not."""
    rows = [row(10, 12, True, left=-20), row(30, 29, False, left=10), row(40, None, scene=1, left=50)]
    rows += [row(70, 60, scene=2, left=30), row(None, 100, scene=1, left=70)]
    found = judge(rows, 0.1)
    assert (found["samples"], found["not_resumed"], found["foretold"], found["foretold_wrongly"]) == (5, 2, 2, 2)
    assert found["largest_error_ticks"] == 10
    assert (found["level_ticks"], found["inside"]) == (30, 2)
    assert found["inside_bound"] == pytest.approx(1.0 - 0.05**0.5)
    assert (found["scenes"]["samples"], found["scenes"]["failures"]) == (3, 1)
    assert found["left_to_imagine_s"] == {"resumed": pytest.approx(1.0), "not_resumed": pytest.approx(6.0)}
    assert found["time_s"]["max"] == pytest.approx(6.0)
    assert found["time_s"]["median"] == pytest.approx(2.9)
    assert found["finished"]["samples"] == 2
    assert found["finished"]["failures"] == 1
    json.dumps(found)


def test_judge_of_starts_that_all_fail():
    found = judge([row(5, None)] * 3, 0.1)
    assert (found["level_ticks"], found["inside"], found["inside_bound"]) == (None, 0, 1.0)
    assert found["time_s"] is None
    assert found["finished"] is None


def test_scenes_whose_subtask_is_not_done_are_counted_once():
    rows = [row(1, 1, done=True, scene=1), row(1, 1, done=False, scene=1), row(1, 1, done=False, scene=1)]
    rows += [row(1, 1, done=True, scene=2), row(1, 1, scene=3)]
    assert finished_by_scene(rows) == {"samples": 2, "failures": 1, "bound": bound(1, 2)}
    assert finished_by_scene([row(1, 1)]) is None


def test_disturbed_runs_by_hand():
    rows = [RunRow(True, 20, 22), RunRow(True, 70, None), RunRow(True, 20, None), RunRow.none()]
    found = judge_runs(rows, 0.1)
    assert (found["samples"], found["came_home"], found["foretold"], found["not_resumed"]) == (4, 3, 1, 2)
    assert (found["foretold_wrongly"], found["largest_error_ticks"]) == (1, 2)
    assert words_of_runs(found).startswith("3 of 4 disturbed runs come home, 2 of these do not resume within 6 s")
    assert judge_runs([], 0.1)["bound"] == 1.0


class Imagining:
    """Its hidden state counts down; what it predicts and recalls is off by 1 in every joint until it is 0."""

    posture_size, horizon, beta, gamma = 8, HORIZON, 30.0, 4.0
    scaling = MinMaxScaling(-np.ones(8), np.ones(8))
    initial_posture, mean_errors = np.zeros(8), [1e-2] * (HORIZON + 1)

    def step(self, x, state):
        left = state - 1.0
        posture = np.full(8, 1.0 if left[0] > 0 else 0.0)
        return np.append(posture, 0.0), left, np.tile(posture, (HORIZON, 1))

    def memory(self, ticks):
        return Memory(np.array([float(ticks + 1)]), np.zeros(9), np.zeros((HORIZON, 8))).imagined(self)


@pytest.mark.parametrize("ticks", [0, 1, 7])
def test_t_by_hand_is_what_the_network_has_left_to_imagine(ticks):
    policy = Imagining()
    at_home = np.zeros((HORIZON + 2, 7))
    assert time_to_resume(policy, policy.memory(ticks), at_home, 0.1, 20, reset=False) == ticks
    assert time_to_resume(policy, policy.memory(ticks), at_home, 0.1, 20, reset=True) == (HORIZON + 1 if ticks else 0)


def test_t_is_none_beyond_the_limit():
    policy = Imagining()
    assert time_to_resume(policy, policy.memory(9), np.zeros((HORIZON + 2, 7)), 0.1, 8, reset=False) is None


def test_t_by_hand_of_an_arm_on_its_way():
    """All joints off by 0.5, the error allowed is 0.2 (4 mean errors of 0.01): the slowest criterion is n = 2."""
    policy = Imagining()
    rows = np.tile(0.5 / 0.9 ** np.arange(HORIZON + 2)[:, None], (1, 7))
    found = time_to_resume(policy, policy.memory(0), rows, 0.1, 60, reset=True)
    needed = int(np.ceil(np.log(0.2 / 0.5) / np.log(0.9)))  # ticks until the joints are within 0.2
    assert found == needed + HORIZON + 1  # and until the oldest that is judged, m_{k-1-2}, is


def test_falls_by_one_a_tick():
    """T is a Lyapunov function: one tick later one tick less is left."""
    policy, home = Imagining(), np.zeros((HORIZON + 2, 7))
    memory = policy.memory(9)
    for left in range(9, -1, -1):
        assert time_to_resume(policy, memory, home, 0.1, 20, reset=False) == left
        memory = memory.imagined(policy)


def scene(rule="reset", seed=5_000_000):
    world = World(resumption=rule)
    return SceneJob(Job(world, WEIGHTS / ENCODER, Controller(WEIGHTS / "lstm.onnx"), seed), 0, RESUMPTIONS)


def test_real_starts_resume_as_foretold_and_do_their_subtask(monkeypatch):
    """The can on the desk, in the hand, and taken from it; the first start of each is run to the end."""
    monkeypatch.setattr("diagrams.hybrid.resumption.STARTS_A_SCENE", 1)
    rows = run_scene(scene())
    assert [row.kind for row in rows] == [kind for kind in KINDS for _ in range(2)]
    for one in rows:
        assert one.foretold is None or one.resumed is None or abs(one.resumed - one.foretold) <= 4
        assert one.rule == "imagined" or one.resumed <= 60
    assert [one.done for one in rows if one.done is not None] == [True] * 3
    # Under the other rule the same starts, and the same ends.
    others = run_scene(scene("imagined"))
    assert [replace(one, done=None) for one in others] == [replace(one, done=None) for one in rows]


def test_real_start_has_the_can_in_the_hand_and_the_arm_on_its_way():
    rollout = build_rollout(World(), WEIGHTS / ENCODER, Controller(WEIGHTS / "lstm.onnx"))
    system = Resumptions(rollout, stored_calibration("recall", rollout.policy, WEIGHTS))
    points, monitor = system.switching_points(EpisodeSampler(World()).sample(5_000_000, "none"))
    assert [point.subtask for point in points] == [1, 2]
    start = Start.drawn("place", points[1], World(), rollout.policy, np.random.default_rng(1))
    resumed, done = system.resume(points[1], start, monitor, reset=True, limit=60)
    assert resumed is not None
    assert done is None
    root = rollout.simulator.get_context()
    cans = rollout.station.GetOutputPort("can_poses").Eval(rollout.station.GetMyContextFromRoot(root))
    assert lifted(cans)
    taken = Start.drawn("can taken", points[1], World(), rollout.policy, np.random.default_rng(1))
    system.resume(points[1], taken, monitor, reset=True, limit=60)
    root = rollout.simulator.get_context()
    cans = rollout.station.GetOutputPort("can_poses").Eval(rollout.station.GetMyContextFromRoot(root))
    assert cans[4:6] == pytest.approx(taken.can_xy, abs=2e-3)


def test_real_start_is_the_same_whatever_was_looked_at_before():
    """In the Context of another scene's episode, after a start under the other rule, as in a clone of its own."""
    rollout = build_rollout(World(), WEIGHTS / ENCODER, Controller(WEIGHTS / "lstm.onnx"))
    system = Resumptions(rollout, stored_calibration("recall", rollout.policy, WEIGHTS))
    (pick, place), monitor = system.switching_points(EpisodeSampler(World()).sample(5_000_000, "none"))
    start = Start.drawn("place", place, World(), rollout.policy, np.random.default_rng(1))

    def resumed():
        found = system.resume(place, start, monitor, reset=True, limit=60)
        root = rollout.simulator.get_context()
        return found, [root.get_discrete_state(i).value().tobytes() for i in range(root.num_discrete_state_groups())]

    rollout.simulator.reset_context(place.context.Clone())
    own = resumed()
    system.switching_points(EpisodeSampler(World()).sample(5_000_003, "none"))
    other = Start.drawn("pick", pick, World(), rollout.policy, np.random.default_rng(2))
    system.resume(pick, other, monitor, reset=False, limit=5)
    assert resumed() == own


def test_real_t_falls_by_one_a_tick_in_the_whole_system():
    """And the system resumes when it is 0."""
    rollout = build_rollout(World(resumption="reset"), WEIGHTS / ENCODER, Controller(WEIGHTS / "lstm.onnx"))
    system = Resumptions(rollout, stored_calibration("recall", rollout.policy, WEIGHTS))
    points, monitor = system.switching_points(EpisodeSampler(World()).sample(5_000_001, "none"))
    start = Start.drawn("pick", points[0], World(), rollout.policy, np.random.default_rng(1))
    ticks, _ = system.resume(points[0], start, monitor, reset=False, limit=120)
    memory, way, limit = start.memory, system.way_home(start.offset), 120
    v = time_to_resume(rollout.policy, memory, way, system.gain, limit, reset=False)
    assert v >= 20
    assert ticks == pytest.approx(v, abs=2)
    initial = rollout.policy.scaling.scale(rollout.policy.initial_posture)[:7]
    for left in range(v, 0, -1):
        assert time_to_resume(rollout.policy, memory, way, system.gain, limit, reset=False) == left
        memory = memory.imagined(rollout.policy)
        way = np.vstack((initial + 0.9 * (way[0] - initial), way))[: len(way)]


def test_real_disturbed_run_resumes_as_foretold():
    found = run_disturbed(replace(scene().job, seed=5_005_000, kind="B", until="as_paper"))
    assert found.came_home
    assert abs(found.resumed - found.foretold) <= 4


def test_starting_anew_takes_no_longer_than_from_the_farthest_posture():
    policy, world = Policy(WEIGHTS / "lstm.onnx"), World()
    worst = worst_ticks(policy, world)
    assert 10 < worst < 60
    rng, initial = np.random.default_rng(0), policy.scaling.scale(policy.initial_posture)[:7]
    memory = Memory(np.zeros(policy.state_size), np.ones(policy.posture_size), np.ones((policy.horizon, 8)))
    for _ in range(50):
        offset = rng.uniform(-HOME_TOLERANCE, HOME_TOLERANCE, 7) / policy.scaling.half_range[:7]
        rows = initial + offset / 0.9 ** np.arange(policy.horizon + 2)[:, None]
        assert time_to_resume(policy, memory, rows, 0.1, 60, reset=True) <= worst


def test_program(tmp_path, monkeypatch):
    """On a network whose recall always fails: nothing resumes, and the exit code says so; scenes that lack a kind."""
    calls = []

    def fake(given):
        calls.append(given.key)
        kinds = ("pick", "place", "can taken") if len(calls) != 2 else ("pick",)
        return [row(None, None, None, given.job.seed, 0, rule, kind) for rule in given.rules for kind in kinds
                for _ in range(15)]  # fmt: skip

    monkeypatch.setattr("diagrams.hybrid.resumption.run_scene", fake)
    weights = save_untrained(tmp_path)
    asked = ["resume", "--weights", str(weights), "--starts", "40", "--compared", "20", "--runs", "0", "--workers", "0"]
    assert analysis.main(analysis.parse([*asked, "--out", str(tmp_path / "out")])) == 1
    found = json.loads((tmp_path / "out" / "resume.json").read_text())
    assert found["rule"] == "reset"
    assert found["rules"]["imagined"]["place"]["samples"] == 20
    assert found["rules"]["reset"]["pick"]["not_resumed"] == 40
    assert found["scenes"] == {"seen": 4, "without": {"pick": 0, "place": 1, "can taken": 1}}
    assert [call.split(" ", 2)[2] for call in calls] == ["reset imagined"] * 3 + ["reset"]
    # Those under both rules first, then all that are lacking at once.
    calls.clear()
    asked = [*asked[:3], "--starts", "60", "--compared", "15", *asked[7:], "--out", str(tmp_path / "other")]
    assert analysis.main(analysis.parse(asked)) == 1
    assert [call.split(" ", 2)[2] for call in calls] == ["reset imagined"] + ["reset"] * 4
    assert (tmp_path / "out" / "resume.png").is_file()
    assert not list((tmp_path / "out").glob("*.jsonl"))


def test_the_other_rule_sees_the_same_starts_and_no_more(tmp_path, monkeypatch):
    """The second scene gives one kind alone; of each kind there are no more than of the world's rule."""

    def fake(given):
        kinds = KINDS if given.job.seed % 2 else ("pick",)
        return [row(5, 5, None, given.job.seed, i, rule, kind) for rule in given.rules for kind in kinds
                for i in range(15)]  # fmt: skip

    monkeypatch.setattr("diagrams.hybrid.resumption.run_scene", fake)
    weights = save_untrained(tmp_path)
    asked = ["resume", "--weights", str(weights), "--starts", "40", "--runs", "0", "--workers", "0"]
    assert analysis.main(analysis.parse([*asked, "--out", str(tmp_path / "out")])) == 0
    found = json.loads((tmp_path / "out" / "resume.json").read_text())["rules"]
    assert {entry["samples"] for rule in found.values() for entry in rule.values()} == {40}


def test_scenes_that_never_give_a_kind_are_told(tmp_path, monkeypatch):
    monkeypatch.setattr("diagrams.hybrid.resumption.run_scene", lambda given: [])
    monkeypatch.setattr("diagrams.hybrid.resumption.MOST_SCENES", 30)
    weights = save_untrained(tmp_path)
    asked = ["resume", "--weights", str(weights), "--runs", "0", "--workers", "0", "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match=r"30 scenes do not give 3000 starts of each kind.*choose less --starts"):
        analysis.main(analysis.parse(asked))


def test_a_number_that_is_too_small_is_named(tmp_path):
    with pytest.raises(InputError, match="--starts 0 is too small: choose 1 or more"):
        Resume(out=tmp_path, starts=0).check()
