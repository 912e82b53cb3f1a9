"""Falsification: the smallest push (diagrams/hybrid/perturbations.py) that defeats the switched controller, searched by Optuna's samplers."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.pool import Worker
from diagrams.episodes.record import Record, record_hash
from diagrams.hybrid.perturbations import Push, judge
from diagrams.world.configuration import World
from diagrams.world.disturbance import Disturbance
from diagrams.world.names import ARM_JOINTS
from diagrams.world.scenario import Scenario
from models.errors import InputError

SAMPLERS = ("tpe", "cmaes", "random")
ASKS_PER_TRIAL = 50  # proposals that are no disturbance are told so; after that many a search gives up


@dataclass(frozen=True)
class Trial:
    """What came of one simulated push."""

    push: Push
    disturbance: Disturbance
    failure: str | None  # one of DEFEATS, or None
    switch_failure: str | None
    task_done: bool
    objective: float
    detection_delay_s: float | None
    moved_deg: float  # norm of the move from the command at the onset, as it came
    record_hash: str  # of the record

    @classmethod
    def of(cls, push: Push, disturbance: Disturbance, outcome: Outcome, record: Record, gamma: float) -> Trial:
        """`gamma`: the threshold of the record's errors."""
        failure, objective = judge(push, outcome, record, float(record.time[1] - record.time[0]), gamma)
        moved = 0.0
        active = np.flatnonzero(record.active)
        if disturbance.target_joints is not None and len(active) and active[0] > 0:
            before = record.desired_posture[active[0] - 1, :ARM_JOINTS]
            moved = float(np.rad2deg(np.linalg.norm(np.array(disturbance.target_joints) - before)))
        return cls(
            push, disturbance, failure, outcome.switch_failure, bool(outcome.success), objective, outcome.detection_delay_s,
            moved, record_hash(record),
        )  # fmt: skip


class TrialLog:
    """The trials of a search on disk, a line each, as they come: a search that was broken off goes on where it was."""

    def __init__(self, path: Path, identity: dict[str, Any]):
        """`identity`: what decides the trials, plain types. Raises InputError where the file is of another search."""
        self._path, self._known = path, {}
        head = json.dumps(identity, sort_keys=True)
        # What a kill left of a last line is no trial.
        lines = path.read_text().splitlines(keepends=True) if path.is_file() else []
        whole = [line for line in lines if line.endswith("\n")]
        if whole and whole[0].rstrip("\n") != head:
            raise InputError(f"{path} is of another search (other arguments or weights): choose another --out")
        for line in whole[1:]:
            entry = json.loads(line)
            self._known[entry["sampler"], entry["number"]] = _trial(entry["trial"])
        path.write_text("".join(whole) or head + "\n")

    def get(self, sampler: str, number: int, push: Push) -> Trial | None:
        """The trial `number` of that sampler, if it is there and of that push."""
        trial = self._known.get((sampler, number))
        return trial if trial is not None and trial.push == push else None

    def add(self, sampler: str, number: int, trial: Trial) -> None:
        """Appends a line."""
        with self._path.open("a") as file:
            file.write(json.dumps({"sampler": sampler, "number": number, "trial": asdict(trial)}) + "\n")


def _trial(entry: dict[str, Any]) -> Trial:
    def tuples(fields: dict[str, Any]) -> dict[str, Any]:
        return {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}

    push, disturbance = Push(**tuples(entry["push"])), Disturbance(**tuples(entry["disturbance"]))
    return Trial(**{**entry, "push": push, "disturbance": disturbance})


_thread = threading.local()  # a renderer belongs to the thread that made it


def _run(world: World, encoder: Path, controller: Controller, episode: Episode) -> tuple[Outcome, Record]:
    if not hasattr(_thread, "worker"):
        _thread.worker = Worker(world, encoder)
    return _thread.worker.rollout(controller).run(episode)


class Pool:
    """Episodes over worker processes, or in one thread of this process (`workers` 1); a context manager."""

    def __init__(self, world: World, encoder: Path, policy: Path, workers: int):
        import multiprocessing

        self._job = world, encoder, Controller(policy)
        self._pool: Executor = (
            ThreadPoolExecutor(1)
            if workers == 1
            else ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
        )

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def run(self, episodes: Iterable[Episode]) -> list[tuple[Outcome, Record]]:
        """Waits for the episodes; may be called from several threads."""
        return [future.result() for future in [self._pool.submit(_run, *self._job, e) for e in episodes]]


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
    scenes: int,
    build: Callable[[Push], Disturbance | None],
    run: Callable[[int, Push, Disturbance], Trial],
    trials: int,
) -> list[Trial]:
    """`trials` simulated pushes in so many scenes, in order, proposed by an Optuna `sampler`; fewer only where it hardly proposes any disturbance.

    `run` is given the trial's number too, from 0.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=sampler)
    found: list[Trial] = []
    for _ in range(ASKS_PER_TRIAL * trials):
        if len(found) == trials:
            break
        ask = study.ask()
        push = Push.propose(ask.suggest_float, scenes)
        disturbance = build(push)
        if disturbance is None:
            study.tell(ask, 3.0)  # worse than any disturbance
            continue
        found.append(run(len(found), push, disturbance))
        study.tell(ask, found[-1].objective)
    return found


def search_all(
    scenes: int,
    build: Callable[[Push], Disturbance | None],
    run: Callable[[Push, Disturbance], Trial],
    trials: int,
    seed: int,
    log: TrialLog,
    samplers: Iterable[str] = SAMPLERS,
    on_trial: Callable[[str, int, Trial], object] = lambda name, number, trial: None,
) -> dict[str, list[Trial]]:
    """One search for each of `samplers`, each with `trials` of its own, at the same time (`run` is called from several threads).

    Each search's course depends on its seed alone, not on the others'. Trials that are in the log are not run again. `on_trial` is called after
    each trial with its number, from 0, one call at a time.
    """
    from tqdm import tqdm

    samplers, found, errors = tuple(samplers), {}, []
    lock = threading.Lock()
    with tqdm(total=trials * len(samplers), desc="falsify", unit="trial", disable=None) as bar:

        def guarded_build(push: Push) -> Disturbance | None:
            with lock:
                return build(push)

        def one(name: str) -> None:
            def known_or_run(number: int, push: Push, disturbance: Disturbance) -> Trial:
                trial = log.get(name, number, push)
                new = run(push, disturbance) if trial is None else trial
                with lock:
                    if trial is None:
                        log.add(name, number, new)
                    bar.update()
                    on_trial(name, number, new)
                return new

            try:
                # Seeds of their own: TPE begins as random search does.
                sampler = make_sampler(name, len(SAMPLERS) * seed + SAMPLERS.index(name))
                found[name] = search(sampler, scenes, guarded_build, known_or_run, trials)
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


def scenario_of(world: World, scene: Episode, disturbance: Disturbance) -> Scenario:
    """The scenario that gives the scene with this disturbance in full."""
    moved = disturbance.can_moved_to
    return Scenario(
        rnn=scene.rnn,
        detector=scene.detector,
        disturbance=disturbance.kind,
        seed=scene.seed,
        can=[float(v) for v in scene.can_xy],
        vacant=scene.vacant,
        experimenter=Disturbance(
            level=disturbance.level,
            subtask=disturbance.subtask,
            target=None if disturbance.target_joints is None else list(disturbance.target_joints),
            hold_ticks=disturbance.hold_ticks,
            can_moved_to=None if moved is None else list(moved),
        ),
        world=world,
    )
