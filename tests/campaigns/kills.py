"""Kills the programs at random moments, and starts them again.

    python tests/campaigns/kills.py --seed 0 --count 20

Each program of tests/campaigns/targets.py runs in its smallest size, its simulations replaced by what fakes.py makes
up. It is killed (kill -9 of all its processes), its driver alone, one of its workers, or it is told to end (SIGINT to
all of them, as Ctrl-C does at a terminal; SIGTERM to the driver), at a moment drawn evenly from the time that it takes,
and then started again. Answered well: what it leaves is what an undisturbed run leaves; what was finished on the disk
is not done again; and for SIGINT and SIGTERM one line that says how to go on, exit code 130 or 143, and no process left
after --patience seconds, in which waiting for a processor is not counted. The longest is told. A moment at which no
worker lives, or by which the program has ended, is no kill: another one is drawn, DRAWS times at most.
"""

import functools
import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from diagrams.episodes.fingerprint import code_hash  # noqa: E402
from diagrams.episodes.pool import MOST_WORKERS  # noqa: E402
from diagrams.episodes.store import RowStore  # noqa: E402
from models.checks import LARGEST_SEED, require_numbers  # noqa: E402
from models.command_line import run as run_program  # noqa: E402
from models.interrupts import ENDED  # noqa: E402
from tests.campaigns import fakes  # noqa: E402
from tests.campaigns.givens import prepare  # noqa: E402
from tests.campaigns.processes import Ended, Forked, run, until  # noqa: E402
from tests.campaigns.targets import TARGETS  # noqa: E402

Case = tuple[str, str, int]  # program, what befalls it, number
TOLD = {"int": (signal.SIGINT, 130), "term": (signal.SIGTERM, 143)}  # exit codes
HOWS = "kill", "driver", "worker", *TOLD
DRAWS = 10  # moments a case, of which one has to hit something
MISSED = "hit nothing"
# What the programs import where they need it: imported once, before they are forked.
MODULES = {
    "falsify": ("diagrams.drawing.falsification", "optuna", "cmaes"), "defeat": ("diagrams.drawing.defeat",),
    "return": ("diagrams.drawing.return_certificate",), "resume": ("diagrams.drawing.resumption",),
    "sweep": ("diagrams.sweeps.summary", "diagrams.sweeps.table"), "teach-lerobot": ("models.data.lerobot",),
    "sweep-blocked": ("diagrams.sweeps.summary", "diagrams.sweeps.table"), "teach": ("models.data.recording",),
    "bench": ("diagrams.monitors.bench_table", "pandas", "pyarrow.parquet", "scipy.stats", "sklearn.covariance"),
    "export": ("models.data.lerobot", "av", "diagrams.monitors.bench_table", "pandas", "pyarrow.parquet"),
    "coverage": ("diagrams.drawing.coverage", "scipy.stats"),
    "cae": ("models.training.cae",), "rnn": ("models.training.rnn",), "recall": ("models.training.recall",),
}  # fmt: skip
BARE = {"teach", "teach-lerobot", "return", "pick_place"}  # need no weights and no data of their own


@dataclass
class KillsArguments:
    """Command line of kills.py."""

    seed: int = 0  # of the moments
    count: int = 20  # kills a program of each kind; with SIGINT and SIGTERM a quarter as many
    targets: list[Literal[*TARGETS]] = field(default_factory=lambda: [name for name in TARGETS if name != "pick_place"])
    hows: list[Literal[*HOWS]] = field(default_factory=lambda: list(HOWS))
    out: Path = Path("outputs/campaigns/kills")  # folder of kills.jsonl: started again, the campaign goes on
    patience: float = 5.0  # s, in which all processes have to be gone
    workers: int = len(os.sched_getaffinity(0))  # programs at a time


class Campaign:
    """The cases, over a folder of inputs and one undisturbed run of each program."""

    def __init__(self, arguments: Any, folder: Path):
        self.arguments, self.folder, self.given = arguments, folder, folder / "given"
        self.seconds = dict[Case, float]()  # until all processes had ended that were told to

    def prepare(self) -> None:
        """Imports what the programs need, and makes their inputs."""
        for name in self.arguments.targets:
            for module in (TARGETS[name].program, *MODULES.get(name, ())):
                importlib.import_module(module)
        if not set(self.arguments.targets) - BARE:
            return
        ended = run(lambda: prepare(self.given), self.folder / "preparing")
        if ended.code != 0:
            raise RuntimeError(f"the inputs cannot be made: {ended.err}")

    def work(self, cases: Sequence[Case], store: RowStore, one: Callable[..., str | None]) -> int:
        """Runs the cases that are not in `store`, a program at a time; prints how many were answered well; 0 if all.

        `one` is given a case's parts and what `undisturbed` found of its program; it says what was wrong, or None.
        """
        from tqdm import tqdm

        missing = [case for case in cases if _key(case) not in store.rows]
        with ThreadPoolExecutor(self.arguments.workers) as threads, tqdm(total=len(cases), disable=None) as bar:
            bar.update(len(cases) - len(missing))
            for name in dict.fromkeys(name for name, _, _ in missing):
                whole, mine = self.undisturbed(name), [case for case in missing if case[0] == name]
                for case, wrong in zip(mine, threads.map(lambda c, w=whole: one(*c, w), mine), strict=True):
                    store.add(_key(case), {"wrong": wrong, "seconds": self.seconds.get(case)})
                    bar.update()
                    if wrong:
                        tqdm.write(f"{_key(case)}: {wrong}", file=sys.stderr)
        if ends := [seconds for case in cases if (seconds := store.rows[_key(case)].get("seconds")) is not None]:
            print(f"told to end, all processes were gone after {max(ends):.2f} s at most")
        well = sum(store.rows[_key(case)]["wrong"] is None for case in cases)
        missed = sum(store.rows[_key(case)]["wrong"] == MISSED for case in cases)
        print(f"{well} of {len(cases)} answered well" + (f", {missed} {MISSED}" if missed else ""))
        return 0 if well == len(cases) else 1

    def undisturbed(self, name: str) -> dict[str, Any]:
        """What the program leaves, its notes, and how long it takes."""
        out = self.folder / name / "undisturbed"
        ended = self._whole(name, out)
        if ended.code != TARGETS[name].code:
            raise RuntimeError(f"{name}, undisturbed: exit code {ended.code}: {ended.err or ended.out}")
        sizes = [path.stat().st_size for path in out.rglob("*") if path.is_file()]
        return {
            "left": self._left(name, out), "notes": self._notes(out), "seconds": ended.seconds, "code": ended.code,
            "sum": sum(sizes), "largest": max(sizes),
        }  # fmt: skip

    def case(self, name: str, how: str, number: int, whole: dict[str, Any]) -> str | None:
        """What was wrong in one case; None: nothing."""
        seed = [self.arguments.seed, list(TARGETS).index(name), HOWS.index(how), number]
        moments = np.random.default_rng(seed).uniform(0.0, whole["seconds"], DRAWS)
        return until_hit(lambda moment: self._at(moment, name, how, number, whole), moments)

    def _at(self, moment: float, name: str, how: str, number: int, whole: dict[str, Any]) -> str | None:
        target, out = TARGETS[name], self.fresh(name, f"{how}-{number}")
        process = Forked(functools.partial(target.run, self.given, out), self._said(out), self._surroundings(out))
        until(process.poll, moment)
        wrong = self._strike(process, name, how, number)
        if wrong == MISSED:
            return wrong
        kept = self._in_process(out, lambda: target.kept(out))
        if isinstance(kept, str):
            return f"what is finished cannot be read after the kill: {kept}"
        before = len(self._notes(out))
        if how != "worker":  # after which it goes on by itself
            ended = self._whole(name, out)
            if ended.code != target.code:
                return f"started again: exit code {ended.code}: {ended.err[-600:] or ended.out[-600:]}"
        again = len(self._notes(out)) - before
        if self._left(name, out) != whole["left"]:
            wrong = wrong or f"it leaves something else: see {out}"
        if again > len(whole["notes"]) - kept:
            wrong = wrong or f"{kept} of {len(whole['notes'])} were finished, {again} were run after that"
        if wrong is None:
            shutil.rmtree(out)
        return wrong

    def _strike(self, process: Forked, name: str, how: str, number: int) -> str | None:
        """Kills the process in the way `how`; what was wrong with its end, MISSED where nothing was hit."""
        patience, (told, code) = self.arguments.patience, TOLD.get(how, (signal.SIGKILL, -signal.SIGKILL))
        if how == "worker":
            hit = _killed(process.workers()[:1])
            ended = hit and process.wait(600.0)
            process.kill()
            until(lambda: process.poll() and not process.members(), 10.0)
            if not hit:
                return MISSED
            return _signalled(process.ended(), TARGETS[name].code) if ended else "it does not end"
        if not process.poll():
            (os.killpg if how in ("kill", "int") else os.kill)(process.pid, told)
        seconds, left = process.ends_within(patience), process.members()
        process.kill()
        if seconds is None:
            process.wait(10.0)
            return f"{len(left)} processes are left after {patience} s"
        if process.code == TARGETS[name].code:  # it was at its end
            return MISSED
        if how in TOLD:
            self.seconds[name, how, number] = seconds
        return _signalled(process.ended(), code)

    def fresh(self, name: str, case: str) -> Path:
        """The folder of a case, without what an earlier moment left."""
        out = self.folder / name / case
        shutil.rmtree(out, ignore_errors=True)
        self._notes_of(out).unlink(missing_ok=True)
        return out

    def _whole(self, name: str, out: Path) -> Ended:
        return run(functools.partial(TARGETS[name].run, self.given, out), self._said(out), self._surroundings(out))

    def _left(self, name: str, out: Path) -> Any:
        return self._in_process(out, lambda: TARGETS[name].files(out))

    def _in_process(self, out: Path, made: Callable[[], Any]) -> Any:
        """What `made` gives, in a process of its own: libraries with threads would not survive a fork; else words."""
        answer = out.with_name(f"{out.name}.answer")
        ended = run(lambda: answer.write_text(json.dumps(made())) and None, self._said(out).with_name("answer"))
        return json.loads(answer.read_text()) if ended.code == 0 else ended.err[-600:]

    def _said(self, out: Path) -> Path:
        return out.parent / f"{out.name}.said" / "program"

    def _surroundings(self, out: Path) -> dict[str, str]:
        return {fakes.NOTES: str(self._notes_of(out)), "PYTHONPATH": str(ROOT)}

    def _notes_of(self, out: Path) -> Path:
        return out.with_name(f"{out.name}.notes")

    def _notes(self, out: Path) -> list[str]:
        path = self._notes_of(out)
        return path.read_text().splitlines() if path.exists() else []


def until_hit(at: Callable[[float], str | None], moments: Sequence[float]) -> str | None:
    """What was wrong at the first of `moments` that hits something; else MISSED."""
    return next((wrong for moment in moments if (wrong := at(moment)) != MISSED), MISSED)


def _killed(pids: Sequence[int]) -> bool:
    """Whether there was a process to kill."""
    try:
        return bool([os.kill(pid, signal.SIGKILL) for pid in pids])
    except ProcessLookupError:
        return False


def _signalled(ended: Ended, code: int) -> str | None:
    """What is wrong with the end of a program; one that was told to end says how to go on."""
    if ended.code != code:
        return f"exit code {ended.code}, not {code}: {ended.err[-600:]}"
    if code not in (130, 143):
        return None
    lines = ended.err.splitlines()
    if len(lines) != 1 or not lines[0].startswith(ENDED) or not ("goes on" in lines[0] or "again" in lines[0]):
        return f"not one line that says how to go on: {ended.err[-600:]}"
    return None


def parse(arguments: list[str] | None = None) -> KillsArguments:
    """The command line."""
    return tyro.cli(KillsArguments, args=arguments, description=__doc__)


def main(arguments: KillsArguments) -> int:
    """Runs what is not in the log yet; returns 0 if all was well, else 1."""
    store = store_of(arguments, "kills")
    folder = Path(tempfile.mkdtemp())  # no TemporaryDirectory: a forked process would remove it at its end
    try:
        with store:
            return _run(arguments, folder, store)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def store_of(arguments: Any, name: str) -> RowStore:
    """The log of the campaign `name` in --out; raises InputError for a number outside of its choices."""
    require_numbers(arguments, {"seed": (0, LARGEST_SEED), "count": (1, 10**6), "workers": (1, MOST_WORKERS)})
    made_with = {"seed": arguments.seed, "code": code_hash("models", "diagrams", "tests/campaigns")}
    return RowStore(arguments.out / f"{name}.jsonl", made_with)


def _run(arguments: KillsArguments, folder: Path, store: RowStore) -> int:
    campaign = Campaign(arguments, folder)
    campaign.prepare()
    cases = [
        (name, how, number)
        for name in arguments.targets
        for how in arguments.hows
        if how not in ("driver", "worker") or TARGETS[name].workers
        for number in range(-(-arguments.count // 4) if how in TOLD else arguments.count)
    ]
    return campaign.work(cases, store, campaign.case)


def _key(case: Case) -> str:
    return "-".join(map(str, case))


if __name__ == "__main__":
    run_program(main, parse)
