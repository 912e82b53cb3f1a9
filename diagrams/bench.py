"""The monitor bench: what is an alarm worth? Every detector on every fault, and what acts, with every recovery.

    python diagrams/bench.py --detectors recall mahalanobis --faults A camera_shift --episodes 2 --out outputs/bench

Each episode is run with the detector off, and all detectors are scored on that one run; each that alarms there, or
only those that --loop names, is run again in closed loop, with each recovery. Started again with the same --out it runs
what is missing; more detectors, loops, faults, severities, training seeds and recoveries may be asked for, fewer too.
diagrams/BENCH.md has the definitions.
`bench.py export` writes its runs as data sets; `bench.py offline` scores recorded runs of anybody's arm;
`bench.py coverage` measures what the calibration promises.
Exit code 0: done; 1: some episode raised an error; 2: bad input.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import tyro

from diagrams.browser.explorer import PAGE, write_explorer, write_replays
from diagrams.episodes.calibration import policy_name
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.monitors.bench_fit import NETWORKS, Fitted, copy_networks, gammas, load_networks
from diagrams.monitors.bench_plan import (
    CALIBRATION_SEED,
    FIT_SEED,
    BenchArguments,
    in_loop,
    switched_off,
    undisturbed,
)
from diagrams.monitors.bench_task import TAPES, BenchTask, error_row, require_whole, run_bench_task
from diagrams.monitors.coverage import Coverage
from diagrams.monitors.export import Export
from diagrams.monitors.fitting import BETA
from diagrams.monitors.offline import Offline
from diagrams.monitors.traces import SHOWN, TRACE
from diagrams.sweeps.cluster_options import ClusterOptions
from diagrams.sweeps.task import believed
from diagrams.world.scenario import load_world
from models.checks import require_plain
from models.command_line import require, run, say
from models.errors import InputError
from models.files.container import write_bytes, write_text
from systems.recoveries.registry import RECOVERIES

ROWS, SUMMARY, PICTURE = "rows.jsonl", "summary.json", "bench.png"  # in the folder --out
# What decides a row beside what decides an episode's; none of the files that make tables of rows.
ROOMS = (
    *(f"diagrams/monitors/{name}.py" for name in (
        "bench_fit", "bench_plan", "bench_task", "fitting", "scoring", "tapes", "traces",
    )),
    "models/data/runs.py", "models/networks/perceptron.py",
)  # fmt: skip


OTHERS = {"export": Export, "offline": Offline, "coverage": Coverage}  # what the first word may name instead of a bench


def parse(arguments: list[str] | None = None) -> BenchArguments | Export | Offline | Coverage:
    """The command line."""
    first, *others = (sys.argv[1:] if arguments is None else arguments) or [""]
    if first in OTHERS:
        return tyro.cli(OTHERS[first], args=others, prog=f"bench.py {first}")
    return tyro.cli(BenchArguments, args=arguments, description=__doc__)


class Crew:
    """Runs tasks and keeps their rows: over one pool of this machine, or over a cluster."""

    def __init__(self, arguments: BenchArguments, store: RowStore, pool: Pool):
        self._arguments, self._store, self._pool = arguments, store, pool

    def run(
        self,
        words: str,
        tasks: Iterable[BenchTask],
        parts: Callable[[list[BenchTask]], Iterable[list[BenchTask]]] = lambda missing: [missing],
    ) -> list[str]:
        """Runs those of `tasks` that are missing; returns the errors of all, a line each.

        `parts`: makes parts of what is missing, one to be run after another, and may leave some out.
        """
        from tqdm import tqdm

        asked, rows, folder, handed = list(tasks), self._store.rows, self._arguments.out, set[str]()
        missing = [t for t in asked if not t.done_by(rows.get(t.key)) or not self._kept(t)]
        missing.sort(key=lambda task: task.diagram)
        print(f"{words}: {len(asked)} episodes, {len(asked) - len(missing)} of them done", flush=True)
        if missing:

            def found() -> Iterator[tuple[BenchTask, dict]]:
                for part in filter(None, parts(missing)):
                    handed.update(task.key for task in part)
                    pool, function = self._workers()
                    yield from pool.run(function, part, given_up=error_row)

            done = believed(found())  # type: ignore[arg-type]
            with tqdm(total=len(missing), desc=words, unit="episode", smoothing=0.1, disable=None) as bar:
                for task, row in done:
                    if (tape := row.pop(TAPES, None)) is not None:
                        write_bytes(folder / TAPES / f"{task.key}.npz", tape)
                    for suffix, content in row.pop(SHOWN, {}).items():
                        write_bytes(folder / SHOWN / f"{task.key}{suffix}", content)
                    self._store.add(task.key, row)
                    bar.update()
        if lost := len(handed - rows.keys()):
            raise InputError(f"{lost} episodes were given up by the cluster: start again with the same --out")
        wrong = (task.key for task in asked if task.key in handed and rows[task.key]["error"] is not None)
        return [f"{key}: {rows[key]['error']}" for key in wrong]

    def _kept(self, task: BenchTask) -> bool:
        """Whether the file that the task leaves is there."""
        left = {"fit": f"{TAPES}/{task.key}.npz", "calibration": ""}.get(task.stage, f"{SHOWN}/{task.key}{TRACE}")
        return (self._arguments.out / left).exists()

    def _workers(self) -> tuple[Any, Callable[[BenchTask], dict]]:
        """See Pool; a cluster is given the files that there are now."""
        networks = self._arguments.out / NETWORKS
        if self._arguments.scheduler is None:
            return self._pool, partial(run_bench_task, networks)
        files = {path.name: path.read_bytes() for path in sorted(networks.iterdir()) if path.is_file()}
        cluster = self._arguments.cluster(files)
        return cluster, cluster.with_files(run_bench_task)


def main(arguments: BenchArguments | Export | Offline | Coverage) -> int:
    """Runs what is missing, writes what is found, prints the table; returns the exit code."""
    if not isinstance(arguments, BenchArguments):
        return arguments.run()
    if arguments.replay is not None:
        from diagrams.monitors.replays import make_replay, of_summary

        arguments.require_replay_of(of_summary(arguments.out, f"--replay {arguments.replay:.80}", lambda made, _: made))
        return make_replay(arguments.out, arguments.replay)
    require("pandas", "pyarrow", "scipy", "sklearn", *(["distributed"] if arguments.scheduler else []))
    from diagrams.monitors.bench_table import TABLE
    from diagrams.monitors.comparison import looks, rounds

    arguments.check()
    world, out = load_world(arguments.world), arguments.out
    made_with = {name: getattr(arguments, name) for name in ("rnn", "fit_runs", "calibration_runs", "delta")}
    made_with |= {"fit_seed": FIT_SEED, "calibration_seed": CALIBRATION_SEED}
    networks = load_networks(arguments, world)
    inside = (path for name in (NETWORKS, TAPES, SHOWN) for path in (out / name).glob("*"))
    for path in (out / TABLE, out / SUMMARY, out / PICTURE, out / PAGE, *inside):
        require_plain(path, "choose another --out")
    arguments.require_cluster()
    with RowStore(out / ROWS, fingerprint(world, *ROOMS, **made_with)) as store, Pool(arguments.workers) as pool:
        crew, promises = Crew(arguments, store, pool), dict[str, Any]()
        for key in (key for key in store.rows if isinstance(key, str)):  # nobody asks for another
            store.read(key, partial(require_whole, key.partition("-")[0]))
        off, errors = list[BenchTask](), list[str]()
        copy_networks(arguments, networks)
        for network in networks:
            tasks = undisturbed(arguments, world, network, "fit")
            _require_none(crew.run(f"{network.path.stem}, runs of the fit", tasks))
            fitted = Fitted(network, arguments.specs, {n: made_with[n] for n in ("fit_runs", "fit_seed")})
            fitted.fit([out / TAPES / f"{task.key}.npz" for task in tasks if store.rows[task.key]["success"]])
            tasks = undisturbed(arguments, world, network, "calibration", fitted.scored())
            _require_none(crew.run(f"{network.path.stem}, runs of the calibration", tasks))
            found = gammas(arguments.specs, [store.rows[task.key] for task in tasks], arguments.delta)
            promises[network.path.stem] = {
                label: {"gamma": c.gamma, "average": c.average, "share": c.share, "mean_errors": fitted.means[label]}
                for label, c in found.items()
            }
            off += switched_off(arguments, world, network, fitted.scored({n: c.gamma for n, c in found.items()}))
        errors += crew.run("detectors off", off)
        loops = [task for episode in off for task in in_loop(arguments, episode, store.rows[episode.key])]
        if arguments.stop_when_decided:
            two, rows = arguments.compared, store.rows
            errors += crew.run("detectors in the loop", loops, partial(rounds, two, off, loops, rows))
            off = [task for some in looks(two, off, loops, rows) for task in some]
            loops = [task for task in loops if task.episode in {episode.episode for episode in off}]
        else:
            errors += crew.run("detectors in the loop", loops)
        return finish(arguments, world.timing.period, off, loops, store.rows, promises, errors)


def _require_none(errors: list[str]) -> None:
    """Raises InputError for an undisturbed run with an error: what comes after would be of too few."""
    if errors:
        raise InputError(f"{len(errors)} undisturbed runs raised an error ({errors[0]}): mend that, then start again")


def finish(
    arguments: BenchArguments,
    period: float,
    off: list[BenchTask],
    loops: list[BenchTask],
    rows: dict[str, dict[str, Any]],
    promises: dict[str, Any],
    errors: list[str],
) -> int:
    """Writes and prints what the rows say; returns the exit code."""
    from diagrams.drawing.bench import save_bench
    from diagrams.monitors.bench_table import cells, flat, half_noticed, pooled, records, text, worth, write_table
    from diagrams.monitors.comparison import comparison_text, comparisons

    recoveries = list({RECOVERIES.label(spec): spec for spec in arguments.recoveries}.values())
    found = records(off, loops, rows, recoveries, period, arguments.acting)
    if not found:
        raise InputError("no episode of them counts: each was void, or raised an error; ask for other --faults")
    path, summary_path = write_table(arguments.out, found), arguments.out / SUMMARY
    given = {name: str(v) if isinstance(v, Path) else v for name, v in dataclasses.asdict(arguments).items()}
    cluster = [option.name for option in dataclasses.fields(ClusterOptions)]
    for name in ("out", "workers", "replay", *cluster):  # which say nothing of what was found
        del given[name]
    of_each, of_all = cells(found), pooled(found)
    compared = comparisons(found, arguments.compared if arguments.stop_when_decided else None)
    summary = {
        "arguments": given,
        "cells": of_each,
        "pooled": of_all,
        "labels": worth(found),
        "comparisons": compared,
        "half_noticed": half_noticed(found),
        "gammas": promises,
        "void": sum(bool(rows[task.key].get("void")) for task in off),
        "errors": len(errors),
    }
    write_text(summary_path, json.dumps(summary, indent=1) + "\n")
    save_bench(summary, {r["fault"]: r["family"] for r in found if r["family"]}, arguments.out / PICTURE)
    shown = [r | {"network": policy_name(r["rnn"], r["training_seed"]).removesuffix(".onnx")} for r in found]
    gamma = {name: {label: g["gamma"] for label, g in of.items()} for name, of in promises.items()}
    page = write_explorer(arguments.out, [flat(cell) for cell in of_all + of_each], shown, gamma, BETA, period)
    write_replays(arguments.out / SHOWN)
    print("\n\n".join(filter(None, (text(summary), comparison_text(compared)))))
    for error in errors:
        say(error)
    print(f"written: {path}, {summary_path}, {arguments.out / PICTURE}, {page}")
    return 1 if errors else 0


if __name__ == "__main__":
    run(main, parse)
