"""What workers run in the campaigns in the place of simulations: made up from the job alone, noted, and quick."""

import os
import time
from pathlib import Path

import numpy as np

PAUSE = 0.03  # s
NOTES = "CAMPAIGN_NOTES"  # names the file


def note(what: str) -> None:
    """Appends a line to the file of notes."""
    time.sleep(PAUSE)
    with open(os.environ[NOTES], "a") as file:
        file.write(what + "\n")


def demonstrate(job):
    from tests.diagrams.teacher_fakes import demonstrate

    note(job[1].name)
    return demonstrate(job)


def run_task(folder: Path, task):
    from tests.diagrams.sweep_fakes import outcome_row

    note(task.key)
    return outcome_row(folder, task)


def run_bench_task(folder: Path, task):
    from tests.diagrams.bench_fakes import bench_row

    note(task.key)
    return bench_row(folder, task)


def record_run(bench: Path, job):
    from tests.diagrams.bench_fakes import recorded

    note(job.name)
    return recorded(job.name, key=job.task.key)


def run_watched(folder: Path, task):
    from tests.diagrams.coverage_fakes import watched_row

    note(task.key)
    return watched_row(folder, task)


def blocked(job):
    _, kind, seeds = job
    note(f"{kind} {seeds[0]}")
    return [seed for seed in seeds if seed % 7 == 0]


def run_validation(job):
    """Raw errors around 1, and under a disturbance 400."""
    from diagrams.episodes.thresholds import ValidationRun
    from tests.diagrams.episode_fakes import outcome, record

    controller = job.controller
    note(f"{controller.policy.name} {controller.detector} {job.kind} {job.seed} {job.until} {controller.calibration}")
    criteria = len(controller.calibration.mean_errors)
    rng = np.random.default_rng(job.seed)
    rows = rng.uniform(0.5, 2.0, (20, criteria))
    disturbed = [] if job.kind == "none" else [np.full(criteria, 400.0 + rng.uniform())]
    return ValidationRun.of(*[outcome(job), record(rows, disturbed, len(disturbed))])


def run_episode(job):
    """Of the falsification: a record made by hand, with what the episode says in its errors."""
    from diagrams.episodes.record import Record
    from tests.diagrams.episode_fakes import OUTCOME
    from tests.diagrams.recorded_run import recorded_run

    episode = job.episode
    note(f"{episode.seed} {episode.disturbance}")
    from dataclasses import replace

    made: Record = recorded_run(seed=episode.seed % 1000)
    made.errors[:, 0] = 1.0 + 0.01 * np.sum(episode.disturbance.target or [episode.disturbance.level or 0.0])
    made.can_poses[:, [0, 7]] = 1.0
    taken = episode.disturbance.kind != "none"
    return replace(
        OUTCOME, seed=episode.seed, disturbance=episode.disturbance.kind, switched=taken,
        switch_failure="not resumed" if taken and episode.disturbance.level > 0.1 else None,
    ), made  # fmt: skip


def run_draw(job):
    from diagrams.hybrid.return_samples import Sample

    world, seed = job
    note(f"episode {seed}")
    rng = np.random.default_rng(seed)
    home = world.initial_posture[:7]
    pair = home + rng.uniform(-0.1, 0.1, (2, 7))
    return tuple(Sample(tuple(row.tolist()), (0.5, 0.0), "left", bool(seed % 2)) for row in pair)


def run_way_home(job):
    from diagrams.hybrid.return_loop import Trajectory

    world, sample = job
    note(sample.key)
    home = world.initial_posture[:7]
    left = 0.9 ** np.arange(90)[:, None]
    return Trajectory(home + left * (np.array(sample.joints) - home), 0.05, None, 0)


def run_scene(given):
    from diagrams.hybrid.resumption import Row
    from diagrams.hybrid.resumption_starts import KINDS

    note(given.key)
    rng = np.random.default_rng(given.job.seed)
    rows = []
    for kind in KINDS:
        for rule in given.rules:
            for number in range(5):
                ticks = int(rng.integers(20))
                done = True if number == 0 and rule == given.job.world.resumption else None
                rows.append(Row(given.job.seed, rule, kind, ticks, ticks, ticks, done))
    return rows


def run_disturbed(job):
    from diagrams.hybrid.resumption import RunRow

    note(f"run {job.seed}")
    return RunRow(True, job.seed % 20, job.seed % 20)


def run_case(job):
    from diagrams.hybrid.defeat_cases import Case

    given, _, branch = job
    episode = given.episode
    note(repr(episode))
    level = float(np.clip(0.2 + 3.0 * abs(episode.can_xy[1]), 0.0, 1.0))
    return Case(episode, level, "not resumed" if level >= 1.0 else None, True, False, 20.0, 400, 100 * branch, "hash")
