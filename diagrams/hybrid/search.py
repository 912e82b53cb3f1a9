"""Searches for the smallest perturbation that defeats the controller: Optuna's samplers with the same budget."""

import threading
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from typing import Any, Self

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record, record_hash
from diagrams.episodes.store import RowStore, of_plain
from diagrams.hybrid.perturbations import Perturbation, judge
from diagrams.hybrid.severity import moved_deg
from models.interrupts import Interrupted, held

SAMPLERS = {"tpe": "TPESampler", "cmaes": "CmaEsSampler", "random": "RandomSampler"}  # Optuna's classes
ASKS_PER_TRIAL = 50  # proposals that are no perturbation are told so; after that many a search gives up


@dataclass(frozen=True)
class Trial:
    """What came of one simulated perturbation."""

    perturbation: Perturbation
    failure: str | None  # one of DEFEATS, or None
    switch_failure: str | None
    task_done: bool
    objective: float
    moved_deg: float  # norm of the move from the command at the onset, as it came
    record_hash: str

    @classmethod
    def of(cls, perturbation: Perturbation, outcome: Outcome, record: Record, gamma: float) -> Self:
        """`gamma`: the threshold of the record's errors."""
        failure, objective = judge(perturbation, outcome, record, float(record.time[1] - record.time[0]), gamma)
        moved = moved_deg(perturbation.disturbance.target, record)
        done, switch_failure = bool(outcome.success), outcome.switch_failure
        return cls(perturbation, failure, switch_failure, done, objective, moved, record_hash(record))

    @classmethod
    def of_row(cls, row: dict[str, Any]) -> Self:
        """From a row of the store: what `asdict` made of a trial."""
        trial: Self = of_plain(cls, row)
        return trial


def make_sampler(name: str, seed: int):
    """Optuna's sampler of SAMPLERS."""
    from optuna import samplers

    # Seeds of their own: TPE begins as random search does.
    return getattr(samplers, SAMPLERS[name])(seed=len(SAMPLERS) * seed + list(SAMPLERS).index(name))


def search(
    sampler, propose: Callable[[Any], Perturbation | None], run: Callable[[int, Perturbation], Trial], trials: int
) -> list[Trial]:
    """`trials` simulated perturbations, in order; fewer only where the Optuna `sampler` hardly proposes any.

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
        perturbation = propose(ask.suggest_float)
        if perturbation is None:
            study.tell(ask, 3.0)  # worse than any perturbation
            continue
        found.append(run(len(found), perturbation))
        study.tell(ask, found[-1].objective)
    return found


def search_all(
    propose: Callable[[Any], Perturbation | None],
    run: Callable[[Perturbation], Trial],
    trials: int,
    seed: int,
    store: RowStore,
    samplers: Collection[str] = SAMPLERS,
    on_trial: Callable[[str, int, Trial], object] = lambda name, number, trial: None,
) -> dict[str, list[Trial]]:
    """One search for each of `samplers`, each with `trials` of its own, at the same time.

    `propose`: see PerturbationSpace. `run` is called from several threads. Each search's course depends on its seed
    alone, not on the others'. Trials that are in the store are not run again. `on_trial` is called after each trial
    with its number, from 0, one call at a time.
    """
    from tqdm import tqdm

    found, errors, lock = dict[str, list[Trial]](), list[BaseException](), threading.Lock()
    bar = tqdm(total=trials * len(samplers), desc="falsify", unit="trial", disable=None)

    def guarded(suggest: Any) -> Perturbation | None:
        with lock:
            return propose(suggest)

    def one(name: str) -> None:
        def known_or_run(number: int, perturbation: Perturbation) -> Trial:
            key = repr(perturbation)
            new = key not in store.rows
            trial = run(perturbation) if new else store.read(key, Trial.of_row)
            with lock:
                if new:
                    store.add(key, asdict(trial))
                bar.update()
                on_trial(name, number, trial)
            return trial

        try:
            found[name] = search(make_sampler(name, seed), guarded, known_or_run, trials)
        except (Exception, Interrupted) as error:
            errors.append(error)

    # No ThreadPoolExecutor: at the interpreter's end it waits for its threads before the pool's workers are let go.
    threads = [threading.Thread(target=one, args=(name,)) for name in samplers]
    # Held: a search ends by itself, where the pool has nothing more for it.
    with held(), bar:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    if errors:
        raise errors[0]
    return {name: found[name] for name in samplers}
