"""`bench.py coverage`: the promise of the calibration, measured on fresh runs, for every detector of a bench."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.episodes.calibration import UNCALIBRATED, policy_name
from diagrams.episodes.cores import cores
from diagrams.episodes.pool import MOST_WORKERS
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART
from diagrams.episodes.thresholds import conformal
from diagrams.monitors.bench_fit import NETWORKS, Fitted
from diagrams.monitors.bench_plan import FIT_SEED, BenchArguments, Network
from diagrams.monitors.bench_task import Scored
from diagrams.monitors.coverage_runs import Runs, Watched, planned
from diagrams.monitors.phase_band import Band, phases
from diagrams.monitors.promise import LEVEL, Threshold, fewest, holm, missed, resampled
from diagrams.monitors.replays import of_summary
from diagrams.world.configuration import World
from diagrams.world.names import DISTURBANCES
from diagrams.world.scenario import load_world
from models.checks import require_numbers, require_plain
from models.command_line import require
from models.errors import InputError
from models.files.container import write_text

RESULT, PICTURE = "coverage.json", "coverage.png"  # in --out
MOST = 100_000  # splits
CALIBRATION, FRESH = "calibration", "fresh"
DISTURBED = DISTURBANCES[1:]


@dataclass
class Coverage:
    """Measures what the calibration of a finished bench promises: gamma from undisturbed runs, false alarms in fresh
    ones, for every detector and delta; a threshold that goes with the phase beside the constant one; misses under A
    and B. Each run is simulated once, with the detector off; a killed one goes on. Writes coverage.json and
    coverage.png. Exit code 1: the false alarms contradict the promise; 2: bad input."""

    bench: Path = Path("outputs/bench")  # --out of the bench; of its networks, the first is taken
    runs: int = 1000  # fresh undisturbed ones
    calibration_runs: int = 299  # undisturbed ones that gamma comes from; no detector was fitted to them
    disturbed: int = 40  # runs of A, and of B
    resamples: int = 200  # calibrations drawn from all undisturbed runs
    deltas: list[float] = field(default_factory=lambda: [0.01, 0.02, 0.05, 0.1])  # share of false alarms, at most
    seed: int = 0  # which evaluation episodes
    workers: int = field(default_factory=cores)  # processes; 0: this one
    out: Path = Path("outputs/coverage")  # folder of the runs and of what is found

    def run(self) -> int:
        """Runs what is missing, writes and prints what is found; returns the exit code."""
        require("scipy")
        self._check()
        world, network, detectors = self._bench()
        for path in (self.out / RESULT, self.out / PICTURE):
            require_plain(path, "choose another --out")
        counts = self.calibration_runs, self.runs
        plan = planned(world, network, detectors, self.seed, counts, dict.fromkeys(DISTURBED, self.disturbed))
        ran = Runs(self.out, self.bench / NETWORKS, plan).run(self.workers)
        measured = Measured.of(ran, [scored.label for scored in detectors], world)
        found = {"network": network.path.stem, **self._asked(), **measured.result(self.deltas, self.resamples)}
        write_text(self.out / RESULT, json.dumps(found, indent=1) + "\n")
        print(text(found))
        from diagrams.drawing.coverage import save_coverage

        save_coverage(found, measured.example(self.deltas), self.out / PICTURE)
        print(f"written: {self.out / RESULT}, {self.out / PICTURE}")
        return 1 if any(cell["contradicted"] for cell in found["cells"]) else 0

    def _asked(self) -> dict[str, Any]:
        names = ("runs", "calibration_runs", "disturbed", "resamples", "deltas", "seed")
        return {"arguments": {name: getattr(self, name) for name in names}}

    def _check(self) -> None:
        """Raises InputError for a value outside its choices."""
        require_numbers(
            self,
            {
                "runs": (1, SEEDS_APART), "calibration_runs": (1, SEEDS_APART), "disturbed": (0, SEEDS_APART),
                "resamples": (1, MOST), "seed": (0, SEED_BLOCKS - 1), "workers": (0, MOST_WORKERS),
            },
        )  # fmt: skip
        if not self.deltas:
            raise InputError("--deltas names nothing: give one or more")
        for delta in self.deltas:
            if not 0.0 < delta < 1.0:
                raise InputError(f"--deltas {delta} is no share: choose them between 0 and 1, such as 0.05")
        self.deltas = list(dict.fromkeys(self.deltas))
        # A half of the calibration runs gives the gamma of the band.
        least = 2 * fewest(min(self.deltas))
        if self.calibration_runs < least:
            raise InputError(
                f"--calibration-runs {self.calibration_runs} are too few for a delta of {min(self.deltas)}: "
                f"take {least} or more, or larger --deltas"
            )

    def _bench(self) -> tuple[World, Network, tuple[Scored, ...]]:
        """World, first network and fitted detectors of the bench; raises InputError where there are none."""
        from models.inference import Policy

        def asked(arguments: BenchArguments, _: Mapping[str, Any]) -> BenchArguments:
            arguments.check()
            return arguments

        arguments = of_summary(self.bench, f"--bench {self.bench}", asked)
        seed = arguments.training_seeds[0]
        path = self.bench / NETWORKS / policy_name(arguments.rnn, seed)
        if not path.is_file():
            raise InputError(f"there is no {path}: run the bench again, or give another --bench")
        policy = Policy(path)
        network = Network(policy.name, seed, path, policy)
        specs = {label: spec for label, spec in arguments.specs.items() if label not in UNCALIBRATED}
        if not specs:
            raise InputError(f"the bench in {self.bench} has no detector with a calibration: run it with others")
        fitted = Fitted(network, specs, {"fit_runs": arguments.fit_runs, "fit_seed": FIT_SEED})
        fitted.read()
        return load_world(arguments.world), network, fitted.scored()


@dataclass(frozen=True)
class Measured:
    """Scores and curves of all runs, by what they are for; `phases` of each run beside it."""

    labels: Sequence[str]
    runs: Mapping[str, Sequence[Watched]]
    phases: Mapping[str, Sequence[np.ndarray]]
    period: float  # s, of the ticks

    @classmethod
    def of(cls, runs: Mapping[str, Sequence[Watched]], labels: Sequence[str], world: World) -> "Measured":
        """`runs`: see `planned`; `labels`: of the detectors, in the order of the runs' ratios."""
        found = {name: [phases(run.posture, world.initial_posture) for run in part] for name, part in runs.items()}
        return cls(labels, runs, found, world.timing.period)

    def result(self, deltas: Sequence[float], resamples: int) -> dict[str, Any]:
        """The cells, one a detector and delta, and what came of the runs; plain types."""
        count = len(self.runs[CALIBRATION]) + len(self.runs[FRESH])
        rng = np.random.default_rng(0)
        splits = [rng.permutation(count) for _ in range(resamples)]
        cells = [cell for label in self.labels for cell in self._cells(label, deltas, splits)]
        for cell, p in zip(cells, holm([cell["constant"]["p"] for cell in cells]), strict=True):
            cell |= {"p_corrected": p, "contradicted": p < LEVEL}
        runs = {name: {"n": len(part), "tasks": sum(run.success for run in part)} for name, part in self.runs.items()}
        return {"ran": runs, "cells": cells}

    def example(self, deltas: Sequence[float]) -> dict[str, Any]:
        """What the picture shows of the first detector's band: see `save_coverage`."""
        label = self.labels[0]
        band, gammas, _ = self._band(label, deltas)
        constant = [Threshold.of(self._scores(label, CALIBRATION), delta).gamma for delta in deltas]
        return {
            "label": label, "mean": band.mean, "scale": band.scale, "gammas": [t.gamma for t in gammas],
            "constant": constant, "curves": [
                (phase, run.ratios[:, 0])
                for phase, run in zip(self.phases[FRESH], self.runs[FRESH], strict=True)
            ],
        }  # fmt: skip

    def _scores(self, label: str, name: str) -> np.ndarray:
        return np.array([run.scores[label] for run in self.runs[name]])

    def _curves(self, label: str, name: str) -> list[np.ndarray]:
        column = self.labels.index(label)
        return [run.ratios[:, column].astype(float) for run in self.runs[name]]

    def _band(self, label: str, deltas: Sequence[float]) -> tuple[Band, list[Threshold], dict[str, list[np.ndarray]]]:
        """The band, fitted to every second calibration run; its gammas, of the others; what it says of all ticks."""
        band = Band.fit(self._curves(label, CALIBRATION)[::2], self.phases[CALIBRATION][::2])
        ticks = {
            name: [band.scores(*run) for run in zip(self._curves(label, name), self.phases[name], strict=True)]
            for name in self.runs
        }
        own = np.array([run.max() for run in ticks[CALIBRATION][1::2]])
        return band, [Threshold.of(own, delta) for delta in deltas], ticks

    def _cells(self, label: str, deltas: Sequence[float], splits: Sequence[np.ndarray]) -> list[dict[str, Any]]:
        calibration, fresh = (self._scores(label, name) for name in (CALIBRATION, FRESH))
        _, band_gammas, ticks = self._band(label, deltas)
        band_fresh = np.array([run.max() for run in ticks[FRESH]])
        found = []
        for delta, of_band in zip(deltas, band_gammas, strict=True):
            constant, confident = Threshold.of(calibration, delta), conformal(calibration, delta)
            found.append(
                {
                    "detector": label,
                    "delta": delta,
                    "constant": constant.judged(fresh),
                    "confident": {
                        "gamma": confident.gamma, "promised": confident.average, "share": confident.share,
                        "false_alarms": int((fresh > confident.gamma).sum()),
                    },
                    "resampled": resampled(np.concatenate((calibration, fresh)), len(calibration), delta, splits),
                    "band": of_band.judged(band_fresh),
                    "disturbed": {
                        kind: {
                            "constant": missed(self._alarms(kind, self._curves(label, kind), constant.gamma)),
                            "band": missed(self._alarms(kind, ticks[kind], of_band.gamma)),
                        }
                        for kind in self.runs if kind not in (CALIBRATION, FRESH)
                    },
                }
            )  # fmt: skip
        return found

    def _alarms(self, kind: str, ticks: Sequence[np.ndarray], gamma: float) -> list[float | None]:
        """s from the onset of the disturbance to the first alarm before its end, of each run; None: a miss."""
        found = list[float | None]()
        for run, values in zip(self.runs[kind], ticks, strict=True):
            assert run.onset is not None  # of a void run nothing is read
            high = np.flatnonzero(values[run.onset : run.end] > gamma)
            found.append(float(high[0]) * self.period if len(high) else None)
        return found


def text(found: Mapping[str, Any]) -> str:
    """The table, a line a detector and delta."""
    cells = found["cells"]
    width = max(len(cell["detector"]) for cell in cells) + 2
    n, kinds = found["ran"][FRESH]["n"], list(cells[0]["disturbed"])
    lines = [
        f"false alarms of {n} fresh undisturbed runs, gamma from {found['ran'][CALIBRATION]['n']}; [in brackets: where "
        f"{1.0 - LEVEL:.0%} of the counts lie if the promise holds]; p: corrected for the number of tests (Holm)",
        f"{'detector':{width}s}{'delta':>7s}{'constant':>16s}{'p':>7s}{'band':>16s}"
        + "".join(f"{f'misses, {kind}':>17s}{'bound':>11s}{'seen s':>11s}" for kind in kinds),
    ]
    for cell in cells:
        counts = (f"{cell[kind]['false_alarms']} {cell[kind]['expected']}" for kind in ("constant", "band"))
        constant, band = counts
        line = f"{cell['detector']:{width}s}{cell['delta']:7.3g}{constant:>16s}{cell['p_corrected']:7.2g}{band:>16s}"
        for kind in kinds:
            one, two = (cell["disturbed"][kind][name] for name in ("constant", "band"))
            misses = f"{one['missed']}, {two['missed']} of {one['n']}"
            bounds = f"{one['bound']:.2f}, {two['bound']:.2f}"
            times = ", ".join("-" if e["detection_s"] is None else f"{e['detection_s']:.1f}" for e in (one, two))
            line += f"{misses:>17s}{bounds:>11s}{times:>11s}"
        lines.append(line + ("  contradicts the promise" if cell["contradicted"] else ""))
    lines.append(
        "Misses, bounds of their probability, seconds to the alarm: of the constant threshold, and of the band."
    )
    return "\n".join(lines)
