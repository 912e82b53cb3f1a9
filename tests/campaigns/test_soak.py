"""A slice of the soak with fakes for the networks; and that what does not hold is found."""

import json
import os
import signal

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.world.configuration import World
from diagrams.world.requirements import SIGNALS
from tests.campaigns import soak
from tests.campaigns.soak import Chance, Limits, SoakArguments, goes_on, in_a_process, main
from tests.campaigns.soak_verdict import growth, judged
from tests.diagrams.closed_loop_fakes import FakeEncoder, FakePolicy

EPISODE = Episode(0, (0.555, -0.041), "left")
TICKS = 60


@pytest.fixture(scope="module")
def rollout():
    world = World()
    return Rollout(world, FakeEncoder(), FakePolicy(world), hands=True)


@pytest.fixture(scope="module")
def sampler(rollout):
    return EpisodeSampler(rollout.world)


@pytest.fixture
def dense(monkeypatch):
    monkeypatch.setattr(soak, "GAP", (2, 5))
    monkeypatch.setattr(soak, "LENGTH", (2, 6))


def run(rollout, sampler, seed):
    rollout.policy.learn(EPISODE)
    rollout.prepare(EPISODE)
    return goes_on(rollout, Chance(seed, rollout, sampler, rollout.policy.gamma), TICKS)


def test_whatever_is_drawn_all_stays_within_its_limits(rollout, sampler, dense):
    first, again, other = (run(rollout, sampler, seed) for seed in (0, 0, 1))
    assert first["digest"] == again["digest"] != other["digest"]
    assert first["disturbances"] == again["disturbances"] != other["disturbances"]
    assert sum(first["disturbances"].values()) >= 8
    for row in (first, other):
        assert row["found"] == {"finite": [0], "command": [0], "effort": [0]}
        assert (row["ticks"], row["diverged"]) == (TICKS, None)
    json.dumps(first)


def test_each_kind_of_disturbance_does_something(rollout, sampler):
    rollout.policy.learn(EPISODE)
    quiet = soak.Chance(0, rollout, sampler, rollout.policy.gamma)
    schedules = {"held": "grip", "moved": "grip", "pulled": "force", "robbed": "can", "dialled": "gamma",
                 "late": "late", "covered": "camera", "darkened": "camera", "frozen": "camera"}  # fmt: skip
    assert set(quiet._kinds) == set(schedules)
    for kind, name in schedules.items():
        rollout.prepare(EPISODE)
        root, chance = rollout.simulator.get_mutable_context(), Chance(0, rollout, sampler, rollout.policy.gamma)
        rollout.advance(0.05)
        chance._kinds[kind](root, 1, kind)
        found = vars(rollout.hands.schedule(root))
        assert {other for other, rows in found.items() if rows} == {name}


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"alpha": np.array([np.nan])}, "finite"),
        ({"position_margin": -1e-6}, "command"),
        ({"speed_margin": -1e-6}, "command"),
        ({"fingers": 0.09}, "command"),
        ({}, None),
    ],
)
def test_what_is_outside_is_found(rollout, changes, what):
    rollout.prepare(EPISODE)
    rollout.advance(0.05)
    limits, command = Limits(rollout), rollout.world.initial_posture.copy()
    command[-1] = changes.get("fingers", command[-1])
    signals = np.array([changes.get(name, 0.0) if name.endswith("margin") else 0.0 for name in SIGNALS])
    limits.see(0, {"alpha": changes.get("alpha", np.zeros(1)), "signals": signals, "desired_posture": command})
    assert {name for name, found in limits.found.items() if found} == ({what} if what else set())
    limits._most = limits._most * 1e-6
    limits.see(1, {"signals": np.zeros(7), "desired_posture": rollout.world.initial_posture})
    assert limits.found["effort"]


def test_memory_is_to_be_flat_after_a_sixth():
    assert growth([100.0, 300.0, 400.0, *[400.0] * 9]) == pytest.approx(1 / 3)  # from the second on
    assert growth([*range(1, 11), *[10.0] * 49, 10.5]) == pytest.approx(0.05)
    assert growth([7.0]) == 0.0


def test_a_fault_of_the_bench_acts_while_people_go_on(monkeypatch):
    monkeypatch.setattr(soak, "LEAST_TICKS", 90)
    row = soak.each_fault(SoakArguments(minutes=1), ("friction",))["faults"]["friction"]
    assert (row["ticks"], row["diverged"]) == (90, None)
    assert row["ticks_acted"]
    assert sum(row["disturbances"].values())
    assert row["found"] == {"finite": [0], "command": [0], "effort": [0]}


ROW = {
    "ticks": 600, "digest": "same", "disturbances": {"held": 20}, "megabytes": [400.0], "p99_ms": 20.0,
    "found": {"finite": [0], "command": [0], "effort": [0]}, "diverged": None, "ticks_picked": 9,
    "ticks_acted": 3,
}  # fmt: skip


def of_faults(changes):
    return {"faults": {"payload": ROW, "friction": ROW | changes}}


FAULTS = of_faults({})
SWEEP = {"episodes": 40, "megabytes": [400.0] * 40, "errors": [0]}


@pytest.mark.parametrize(
    ("part", "changes", "broken"),
    [
        ("second run", {}, None),
        ("second run", {"digest": "other"}, "the two runs are the same"),
        ("second run", {"diverged": "tick 9: the simulation diverged"}, "second run: runs to its end"),
        ("second run", {"disturbances": {"held": 15}}, "second run: enough disturbances"),
        ("second run", {"found": ROW["found"] | {"effort": [2, "tick 3", "tick 4"]}}, "second run: effort"),
        ("second run", {"megabytes": [400.0, 409.0]}, "second run: memory flat to 2 %"),
        ("faults", of_faults({"diverged": "tick 1"}), "faults: run to their end"),
        ("faults", of_faults({"ticks_acted": 0}), "faults: each one acts"),
        ("faults", of_faults({"found": ROW["found"] | {"effort": [2, "tick 3"]}}), "faults: effort"),
        ("faults again", of_faults({"digest": "other"}), "the faults are the same"),
        ("sweep", {"megabytes": [*[400.0] * 39, 421.0]}, "sweep: memory flat to 5 %"),
        ("sweep", {"errors": [1, "one"]}, "sweep: no error"),
        ("sweep", {"error": "Traceback"}, "sweep: runs to its end"),
    ],
)
def test_what_does_not_hold_is_said(part, changes, broken):
    rows = {"first run": ROW, "second run": ROW, "faults": FAULTS, "faults again": FAULTS, "sweep": SWEEP}
    held = judged(1, rows | {part: rows[part] | changes})
    assert [name for name, (good, _) in held.items() if not good] == ([broken] if broken else [])


def killed(arguments):
    os.kill(os.getpid(), signal.SIGKILL)


def raises(arguments):
    raise ValueError("it broke")


def test_a_part_that_dies_or_raises_is_an_error():
    assert in_a_process(killed, SoakArguments()) == {"error": "its process ended with -9"}
    assert "ValueError: it broke" in in_a_process(raises, SoakArguments())["error"]


def test_finished_parts_are_kept(tmp_path, monkeypatch, capsys):
    parts = {
        "first run": lambda _: ROW, "second run": killed, "faults": lambda _: FAULTS, "faults again": lambda _: FAULTS,
        "sweep": lambda _: SWEEP,
    }  # fmt: skip
    monkeypatch.setattr(soak, "PARTS", parts)
    arguments = SoakArguments(minutes=1, out=tmp_path)
    assert main(arguments) == 1
    assert "NOT HELD: second run: runs to its end" in capsys.readouterr().out
    monkeypatch.setattr(soak, "PARTS", parts | {"first run": killed, "second run": lambda _: ROW})
    assert main(arguments) == 0
    words = capsys.readouterr().out
    assert "first run ..." not in words
    assert words.splitlines()[-1] == "26 of 26 held"
