"""Falsification: the smallest disturbance that defeats the switched controller, searched by Optuna's samplers.

One family of disturbances holds both of the paper's: the arm is moved by `size` (deg, norm over the joints) along a direction, from a moment on,
and held there for a while; a size of nothing is a mere stop. Defeated means: not detected, not returned or not resumed (diagrams/episode.py).
A push that is not detected is no defeat where the task is done all the same: the network has coped with it. As in the draws, a push whose forced
way or straight way home would touch the scene is none, and costs no trial.

What is minimised: the magnitude in [0, 1] where the controller is defeated, else 1 + its margin in [0, 1].
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from diagrams.clearance import Clearance
from diagrams.draws import LIMIT_MARGIN, ONSET_LEVELS
from diagrams.episode import DETECTION_TICKS, RESUME_SECONDS, DisturbanceDraw, Episode, Outcome
from diagrams.kinematics import HandKinematics
from diagrams.records import digest
from diagrams.rollout import Record
from diagrams.scenario import Experimenter, Scenario, World
from diagrams.station import ARM_JOINTS

DEFEATS = ("not detected", "not returned", "not resumed")
MAX_SIZE_DEG = 60.0  # norm over the joints
HOLD_TICKS = (0, 25)
SAMPLERS = ("tpe", "cmaes", "random")
ASKS_PER_TRIAL = 50  # proposals that are no disturbance are told so; after that many a search gives up


@dataclass(frozen=True)
class Push:
    """A disturbance as it is searched for.

    `moment` in [0, 1): the first half is subtask 1, the second subtask 2, each from the earliest distance to the goal to the latest.
    """

    size_deg: float
    direction: tuple[float, ...]  # (7,), any length
    moment: float
    hold_ticks: int

    @property
    def subtask(self) -> int:
        """1 or 2."""
        return 1 if self.moment < 0.5 else 2

    @property
    def level(self) -> float:
        """Distance to the goal at which it begins, m."""
        near, far = ONSET_LEVELS[self.subtask]
        return float(far + (near - far) * (2.0 * self.moment % 1.0))

    @property
    def offset(self) -> np.ndarray:
        """(7,) rad, by which the arm is moved; nothing along no direction."""
        direction = np.asarray(self.direction)
        return np.deg2rad(self.size_deg) * direction / max(float(np.linalg.norm(direction)), 1e-9)

    @property
    def magnitude(self) -> float:
        """How large it is, in [0, 1]: half of it the size, half the length."""
        return 0.5 * self.size_deg / MAX_SIZE_DEG + 0.5 * self.hold_ticks / HOLD_TICKS[1]


@dataclass(frozen=True)
class NominalRun:
    """The undisturbed run of the scene, for the postures at the moments: a row a tick for each subtask."""

    distances: dict[int, np.ndarray]  # by subtask: to the goal, m
    commands: dict[int, np.ndarray]  # by subtask: (n, 7) the command that holds at that tick, rad

    @classmethod
    def of(cls, record: Record, hand: HandKinematics, place: np.ndarray) -> NominalRun:
        """From an undisturbed run's record; `place` (3,): centre of the can on its spot, m, world."""
        can = record.can_poses[:, 4:7]
        grasp = np.array([hand.grasp_position(joints[:ARM_JOINTS]) for joints in record.posture])
        commands = record.desired_posture[:, :ARM_JOINTS]
        return cls(
            {1: np.linalg.norm(grasp - can, axis=1), 2: np.linalg.norm(can - place, axis=1)}, {1: commands, 2: commands}
        )

    def command_at(self, subtask: int, level: float) -> np.ndarray | None:
        """(7,) rad: the command when the distance first falls below `level` (m); None where it does not."""
        below = np.flatnonzero(self.distances[subtask] < level)
        return self.commands[subtask][max(int(below[0]) - 1, 0)] if len(below) else None


class PushBuilder:
    """Turns a Push into a disturbance of one scene, or says that it is none."""

    def __init__(self, world: World, scene: Episode, nominal: NominalRun):
        self._scene, self._nominal = scene, nominal
        self._home = world.initial_posture[:ARM_JOINTS]
        hand = HandKinematics(self._home)
        self._lower, self._upper = hand.lower + LIMIT_MARGIN, hand.upper - LIMIT_MARGIN
        self._clearance = Clearance()

    def disturbance(self, push: Push) -> DisturbanceDraw | None:
        """None where the moment does not come, or the arm would leave its limits or touch the scene on its way there or home."""
        start = self._nominal.command_at(push.subtask, push.level)
        if start is None:
            return None
        target = start + push.offset
        if np.any(target < self._lower) or np.any(target > self._upper):
            return None
        self._clearance.set_scene(self._scene.can_xy if push.subtask == 1 else None, self._scene.vacant)
        for way in ((start, target), (target, self._home)):
            if self._clearance.straight_way_touches(*way) is not None:
                return None
        return DisturbanceDraw(
            "A", push.subtask, push.level, tuple(float(q) for q in target), push.hold_ticks, can_moved_to=None
        )


@dataclass(frozen=True)
class Trial:
    """What came of one simulated push."""

    push: Push
    disturbance: DisturbanceDraw
    failure: str | None  # one of DEFEATS, or None
    switch_failure: str | None
    task_done: bool
    objective: float
    detection_delay_s: float | None
    moved_deg: float  # norm of the move from the command at the onset, as it came
    digest: str  # of the record


def judge(push: Push, outcome: Outcome, period: float) -> tuple[str | None, float]:
    """The kind of defeat (None without one) and what is minimised."""
    failure = outcome.switch_failure if outcome.switch_failure in DEFEATS else None
    if failure == "not detected" and outcome.success:
        failure = None
    if failure is not None:
        return failure, push.magnitude
    margins = [1.0]
    if outcome.detection_delay_s is not None:
        allowed = (8 + push.hold_ticks + DETECTION_TICKS) * period
        margins.append(1.0 - outcome.detection_delay_s / allowed)
    if outcome.resume_s is not None:
        margins.append(1.0 - outcome.resume_s / RESUME_SECONDS)
    return None, 1.0 + float(np.clip(min(margins), 0.0, 1.0))


class Falsifier:
    """Runs pushes in one scene: the diagram, built once a process."""

    def __init__(self, rollout, scene: Episode):
        """`rollout`: a Rollout; `scene`: the episode without its disturbance."""
        self._rollout, self._scene = rollout, scene

    def run(self, push: Push, disturbance: DisturbanceDraw) -> Trial:
        """Simulates one push to the end of the task."""
        outcome, record = self._rollout.run(replace(self._scene, disturbance=disturbance))
        failure, objective = judge(push, outcome, self._rollout.world.timing.period)
        moved = 0.0
        active = np.flatnonzero(record.active)
        if len(active) and active[0] > 0:
            before = record.desired_posture[active[0] - 1, :ARM_JOINTS]
            moved = float(np.rad2deg(np.linalg.norm(np.array(disturbance.target_joints) - before)))
        return Trial(
            push, disturbance, failure, outcome.switch_failure, outcome.success, objective, outcome.detection_delay_s,
            moved, digest(record),
        )  # fmt: skip


_falsifier: Falsifier | None = None


def _start(world: World, encoder: Path, policy: Path, scene: Episode) -> None:
    global _falsifier
    import os

    os.environ["OMP_NUM_THREADS"] = "1"
    import torch

    from diagrams.rollout import Rollout
    from models.inference import Encoder, Policy

    torch.set_num_threads(1)
    _falsifier = Falsifier(Rollout(world, Encoder(encoder), Policy(policy)), scene)


def _run(push: Push, disturbance: DisturbanceDraw) -> Trial:
    assert _falsifier is not None
    return _falsifier.run(push, disturbance)


class Pool:
    """Worker processes that simulate pushes; a context manager."""

    def __init__(self, world: World, encoder: Path, policy: Path, scene: Episode, workers: int):
        import multiprocessing

        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(
            workers, mp_context=spawn, initializer=_start, initargs=(world, encoder, policy, scene)
        )

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def __call__(self, push: Push, disturbance: DisturbanceDraw) -> Trial:
        """Waits for one trial; may be called from several threads."""
        return self._pool.submit(_run, push, disturbance).result()


def make_sampler(name: str, seed: int):
    """Optuna's sampler of SAMPLERS."""
    import optuna

    if name == "tpe":
        return optuna.samplers.TPESampler(seed=seed)
    if name == "cmaes":
        return optuna.samplers.CmaEsSampler(seed=seed)
    return optuna.samplers.RandomSampler(seed=seed)


def search(
    sampler,
    build: Callable[[Push], DisturbanceDraw | None],
    run: Callable[[Push, DisturbanceDraw], Trial],
    trials: int,
    on_trial: Callable[[Trial], object] = lambda _: None,
) -> list[Trial]:
    """`trials` simulated pushes, in order, proposed by an Optuna `sampler`; fewer only where it hardly proposes any disturbance."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=sampler)
    found: list[Trial] = []
    for _ in range(ASKS_PER_TRIAL * trials):
        if len(found) == trials:
            break
        ask = study.ask()
        push = Push(
            size_deg=ask.suggest_float("size_deg", 0.0, MAX_SIZE_DEG),
            direction=tuple(ask.suggest_float(f"direction_{j + 1}", -1.0, 1.0) for j in range(ARM_JOINTS)),
            moment=ask.suggest_float("moment", 0.0, 0.9999),
            hold_ticks=round(ask.suggest_float("hold_ticks", *map(float, HOLD_TICKS))),
        )
        disturbance = build(push)
        if disturbance is None:
            study.tell(ask, 3.0)  # worse than any disturbance
            continue
        trial = run(push, disturbance)
        study.tell(ask, trial.objective)
        found.append(trial)
        on_trial(trial)
    return found


def search_all(
    build: Callable[[Push], DisturbanceDraw | None],
    run: Callable[[Push, DisturbanceDraw], Trial],
    trials: int,
    seed: int,
    samplers: Iterable[str] = SAMPLERS,
    on_trial: Callable[[str, Trial], object] = lambda name, trial: None,
) -> dict[str, list[Trial]]:
    """One search for each of `samplers`, each with `trials` of its own, at the same time (`run` is called from several threads).

    Each search's course depends on its seed alone, not on the others'. `on_trial` is called after each trial, one call at a time.
    """
    from tqdm import tqdm

    samplers, found, errors = tuple(samplers), {}, []
    lock = threading.Lock()
    with tqdm(total=trials * len(samplers), desc="falsify", unit="trial", disable=None) as bar:

        def guarded_build(push: Push) -> DisturbanceDraw | None:
            with lock:
                return build(push)

        def done(name: str, trial: Trial) -> None:
            with lock:
                bar.update()
                on_trial(name, trial)

        def one(name: str) -> None:
            try:
                # Seeds of their own: TPE begins as random search does.
                sampler = make_sampler(name, len(SAMPLERS) * seed + SAMPLERS.index(name))
                found[name] = search(sampler, guarded_build, run, trials, lambda trial: done(name, trial))
            except Exception as error:
                errors.append(error)

        threads = [threading.Thread(target=one, args=(name,)) for name in samplers]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    if errors:
        raise errors[0]
    return {name: found[name] for name in samplers}


def scenario_of(world: World, scene: Episode, disturbance: DisturbanceDraw) -> Scenario:
    """The scenario that gives the scene with this disturbance in full."""
    moved = disturbance.can_moved_to
    return Scenario(
        rnn=scene.rnn,
        detector=scene.detector,
        disturbance=disturbance.kind,
        seed=scene.seed,
        can=[float(v) for v in scene.can_xy],
        vacant=scene.vacant,
        experimenter=Experimenter(
            level=disturbance.level,
            subtask=disturbance.subtask,
            target=None if disturbance.target_joints is None else list(disturbance.target_joints),
            hold_ticks=disturbance.hold_ticks,
            can_moved_to=None if moved is None else list(moved),
        ),
        world=world,
    )


def report(found: dict[str, list[Trial]], files: dict[tuple[str, int], str], scene: Episode) -> dict:
    """Plain types: counterexamples, smallest first; what each sampler reached. `files`: name of the scenario file by sampler and trial."""
    counterexamples = [
        {
            "file": files[name, n],
            "sampler": name,
            "trial": n + 1,
            "failure": trial.failure,
            "size_deg": trial.moved_deg,
            "length_ticks": 8 + trial.push.hold_ticks,
            "magnitude": trial.push.magnitude,
            "subtask": trial.push.subtask,
            "level_m": trial.push.level,
            "digest": trial.digest,
        }
        for name, trials in found.items()
        for n, trial in enumerate(trials)
        if trial.failure is not None
    ]
    counterexamples.sort(key=lambda c: (c["magnitude"], c["file"]))

    def first(trials: list[Trial]) -> int | None:
        return next((n for n, trial in enumerate(trials, start=1) if trial.failure is not None), None)

    return {
        "scene": {"seed": scene.seed, "can_xy": list(scene.can_xy), "vacant": scene.vacant, "rnn": scene.rnn},
        "trials": {name: len(trials) for name, trials in found.items()},
        "trials_to_first": {name: first(trials) for name, trials in found.items()},
        "smallest_magnitude": {
            name: min((t.push.magnitude for t in trials if t.failure), default=None) for name, trials in found.items()
        },
        "failures": {
            name: {kind: sum(t.failure == kind for t in trials) for kind in DEFEATS} for name, trials in found.items()
        },
        "undetected_but_done": {
            name: sum(t.switch_failure == "not detected" and t.task_done for t in trials)
            for name, trials in found.items()
        },
        "counterexamples": counterexamples,
        "all_trials": {name: [_plain(trial) for trial in trials] for name, trials in found.items()},
    }


def _plain(trial: Trial) -> dict:
    return asdict(trial) | {"magnitude": trial.push.magnitude}


def save_search(found: dict[str, list[Trial]], path: Path) -> None:
    """The best objective so far over the trials of each sampler (below 1: a counterexample's magnitude), and all trials by size and length."""
    from diagrams.pictures_of_analysis import BLUE, GREEN, ORANGE, RED, new_figure, save

    figure, (left, right) = new_figure(1, 2, figsize=(12, 4.6))
    for (name, trials), colour in zip(found.items(), (BLUE, RED, GREEN), strict=False):
        best = np.fmin.accumulate([t.objective for t in trials] or [np.nan])
        left.step(np.arange(1, len(best) + 1), best, where="post", color=colour, label=name)
    left.set_xlim(0, max(map(len, found.values()), default=0) + 1)
    left.set_xlabel("trials")
    left.axhline(1.0, color="0.5", lw=0.8, ls="--")
    left.text(0.5, 0.98, "below: magnitude of a counterexample", fontsize=8, va="top")
    left.text(0.5, 1.02, "above: 1 + margin to one", fontsize=8, va="bottom")
    left.set_ylabel("best objective so far")
    left.set_ylim(0, 2)
    left.legend()
    marks = {None: (".", "0.6"), "not detected": ("o", ORANGE), "not returned": ("s", RED), "not resumed": ("^", BLUE)}
    everything = [trial for trials in found.values() for trial in trials]
    for kind, (mark, colour) in marks.items():
        chosen = [t for t in everything if t.failure == kind]
        right.plot(
            [t.moved_deg for t in chosen], [8 + t.push.hold_ticks for t in chosen], mark, color=colour, ls="",
            label=f"{kind or 'withstood'} ({len(chosen)})",
        )  # fmt: skip
    right.set_xlabel("size (deg, norm over the joints)")
    right.set_ylabel("length (ticks)")
    right.legend(fontsize=8)
    save(figure, path)
