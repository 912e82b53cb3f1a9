"""The runs that the promise of the calibration is measured on: each simulated once, with the detector off.

What is kept of a run: each detector's score, and in a file its errors by their means tick by tick, with the posture
that was measured. Statistics of these are in coverage.py and the files that it imports: to change them costs no run.
"""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.episodes.fingerprint import code_hash, fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.sampling import episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.monitors.bench_plan import CALIBRATION_SEED, NONE, Network
from diagrams.monitors.bench_task import BenchTask, Scored, all_ratios, error_row, job_of, kept_policy
from diagrams.monitors.tapes import run_taped
from diagrams.sweeps.task import believed
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.container import write_bytes

ROWS, SCORES = "rows.jsonl", "scores"  # in --out: a row a run; a folder, a file a run
# What decides a row beside what decides an episode's. None of the files that do statistics.
ROOMS = (
    *(f"diagrams/monitors/{name}.py" for name in ("coverage_runs", "bench_task", "tapes")),
    "models/data/runs.py", "models/networks/perceptron.py",
)  # fmt: skip


@dataclass(frozen=True)
class Watched:
    """What is known of a run.

    Attributes:
        scores: the largest error by its mean of the whole run, by the detector's label.
        ratios: (T, D) of each tick, of the detectors in the order of `scores`; single precision.
        posture: (T, M) m_k as it was measured; rad and m.
        onset: tick at whose update the disturbance began; None: there was none.
        end: first tick after it; without one, T.
        success: whether the task was done.
    """

    scores: Mapping[str, float]
    ratios: np.ndarray
    posture: np.ndarray
    onset: int | None
    end: int
    success: bool


def planned(
    world: World,
    network: Network,
    detectors: tuple[Scored, ...],
    seed: int,
    counts: tuple[int, int],
    disturbed: Mapping[str, int],
) -> dict[str, list[BenchTask]]:
    """The runs by what they are for: `calibration`, `fresh`, and each kind of disturbance.

    Calibration runs have the seeds of the bench's own, which no detector was fitted to; all others are evaluation
    episodes of `seed`. `counts`: of calibration runs and fresh ones; `disturbed`: of each kind.
    """

    def tasks(kind: str, purpose: str, seed: int, count: int) -> list[BenchTask]:
        same = world, network.rnn, network.training_seed, kind, None
        seeds = episode_seeds(purpose, seed, count) if count else []
        return [BenchTask("calibration", *same, s, network.policy.hash, detectors) for s in seeds]

    return {
        "calibration": tasks(NONE, "validation", CALIBRATION_SEED, counts[0]),
        "fresh": tasks(NONE, "evaluation", seed, counts[1]),
        **{kind: tasks(kind, "evaluation", seed, count) for kind, count in disturbed.items()},
    }


def run_watched(folder: Path, task: BenchTask) -> dict[str, Any]:
    """Runs it in a worker with the files in `folder`; its row, with `error` and `traceback` set if it raised."""
    try:
        if task.code != code_hash():
            raise InputError(f"this worker has another version of the program ({code_hash()}, the first {task.code})")
        job = job_of(folder, task)
        run, path = run_taped(job), job.controller.policy
        if run.outcome.weights_hash != task.weights_hash:
            raise InputError(f"{path} was changed meanwhile: put it back")
        policy, found = kept_policy(path, task), all_ratios(path, task, run)
        arrays = {
            "labels": np.array([*found]),
            "ratios": np.stack([*found.values()], axis=1).astype(np.float32),
            "posture": policy.scaling.unscale(run.tape.posture).astype(np.float32),
        }
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        hashes = {scored.label: scored.hash for scored in task.detectors}
        names = ("success", "void", "failure", "sim_seconds", "weights_hash")
        return {name: getattr(run.outcome, name) for name in names} | {
            "onset": run.onset, "end": run.end, "ticks": len(run.tape.posture),
            "detectors": {n: {"hash": hashes[n], "score": float(ratio.max())} for n, ratio in found.items()},
            SCORES: file.getvalue(), "error": None, "traceback": None,
        }  # fmt: skip
    except (Exception, SystemExit) as error:  # Drake calls exit for some of its errors
        return error_row(task, error)


class Runs:
    """Runs what is missing in a folder, and reads what is there."""

    def __init__(self, out: Path, networks: Path, plan: Mapping[str, Sequence[BenchTask]]):
        """`networks`: folder of the network's file and what the detectors learned; `plan`: see `planned`."""
        self._out, self._networks, self._plan = out, networks, plan

    def run(self, workers: int) -> dict[str, list[Watched]]:
        """Of each entry of the plan its runs, in order; not of disturbances that never came.

        Raises InputError for a run that raised an error: of the others alone nothing could be promised.
        """
        from tqdm import tqdm

        tasks = [task for part in self._plan.values() for task in part]
        made_with = fingerprint(tasks[0].world, *ROOMS, rnn=tasks[0].rnn, training_seed=tasks[0].training_seed)
        with RowStore(self._out / ROWS, made_with) as store, Pool(workers) as pool:
            for key in list(store.rows):
                store.read(key, _require_whole)
            missing = [t for t in tasks if not t.done_by(store.rows.get(t.key)) or not self._file(t).exists()]
            print(f"{len(tasks)} runs, {len(tasks) - len(missing)} of them done", flush=True)
            done: Any = believed(pool.run(partial(run_watched, self._networks), missing, given_up=error_row))  # type: ignore[arg-type]
            with tqdm(total=len(missing), desc="runs", unit="run", smoothing=0.02, disable=None) as bar:
                for task, row in done:
                    if (scores := row.pop(SCORES, None)) is not None:
                        write_bytes(self._file(task), scores)
                    store.add(task.key, row)
                    bar.update()
            errors = [f"{t.key}: {store.rows[t.key]['error']}" for t in tasks if store.rows[t.key]["error"] is not None]
            if errors:
                raise InputError(f"{len(errors)} runs raised an error ({errors[0]}): mend that, then start again")
            return {name: list(self._read(part, store.rows)) for name, part in self._plan.items()}

    def _file(self, task: BenchTask) -> Path:
        return self._out / SCORES / f"{task.key}.npz"

    def _read(self, tasks: Sequence[BenchTask], rows: Mapping[str, dict[str, Any]]) -> Iterator[Watched]:
        for task in tasks:
            row, path = rows[task.key], self._file(task)
            if row["void"]:
                continue
            labels = [scored.label for scored in task.detectors]
            try:
                with np.load(path, allow_pickle=False) as file:
                    order, ratios, posture = file["labels"].tolist(), file["ratios"], file["posture"]
                columns = [order.index(label) for label in labels]
                if not len(ratios) == len(posture) == row["ticks"] or ratios.shape[1:] != (len(order),):
                    raise ValueError(f"{len(ratios)} ticks, not {row['ticks']}")
            except Exception as error:  # numpy and zip raise a dozen types
                words = " ".join(str(error).split())[:200] or type(error).__name__
                raise InputError(f"{path} is damaged ({words}): delete it, the same command makes it again") from error
            scores = {label: row["detectors"][label]["score"] for label in labels}
            yield Watched(scores, ratios[:, columns], posture, row["onset"], row["end"], row["success"])


def _require_whole(row: Any) -> None:
    """Raises an error that `RowStore.read` knows for a row that no run leaves."""
    whole = [isinstance(row["weights_hash"], str), isinstance(row["error"], str | None)]
    if row["error"] is None:
        ticks, onset, end = row["ticks"], row["onset"], row["end"]
        whole += [isinstance(row["success"], bool), isinstance(row["void"], bool)]
        whole += [type(ticks) is int and type(end) is int and 0 < end <= ticks]
        whole += [onset is None or (type(onset) is int and 0 <= onset < end)]
        for said in row["detectors"].values():
            whole += [isinstance(said["hash"], str), isinstance(said["score"], float), np.isfinite(said["score"])]
    if not all(whole):
        raise ValueError(f"no row of a run: {json.dumps(row)[:80]}")
