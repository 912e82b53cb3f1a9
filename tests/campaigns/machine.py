"""Runs the programs on machines that are not as they should be.

    python tests/campaigns/machine.py --seed 0 --count 2

Every condition of tests/campaigns/conditions.py, and two programs with the same --out, with every program of
tests/campaigns/targets.py that it concerns, --count times: how full a disk is, or how large a file may be, is drawn.
Answered well: the program ends as an undisturbed run, or, unless the condition takes nothing from it, with exit code 2
and lines that all begin with `error:` or `warning:`; there is no traceback; and started again on a sound machine it
leaves what an undisturbed run leaves.
"""

import functools
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import numpy as np
import tyro

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from diagrams.episodes.store import RowStore  # noqa: E402
from models.command_line import run as run_program  # noqa: E402
from tests.campaigns.conditions import CONDITIONS, Condition, addresses, command, own_mounts  # noqa: E402
from tests.campaigns.kills import DRAWS, MISSED, Campaign, store_of, until_hit  # noqa: E402
from tests.campaigns.processes import Ended, Forked, run  # noqa: E402
from tests.campaigns.targets import TARGETS  # noqa: E402

TWO = "two programs"
LOCKED = ("teach", "teach-lerobot", "cae", "rnn", "recall", "calibrate", "baselines", "sweep", "sweep-blocked",
          "falsify", "return", "resume", "defeat", "bench", "export", "coverage")  # fmt: skip


@dataclass
class MachineArguments:
    """Command line of machine.py."""

    seed: int = 0
    count: int = 2  # cases a condition and program
    conditions: list[Literal[*CONDITIONS, TWO]] = field(default_factory=lambda: [*CONDITIONS, TWO])
    targets: list[Literal[*TARGETS]] = field(default_factory=lambda: list(TARGETS))
    out: Path = Path("outputs/campaigns/machine")  # folder of machine.jsonl: started again, the campaign goes on
    workers: int = len(os.sched_getaffinity(0))  # programs at a time


class MachineCampaign(Campaign):
    """The cases."""

    def undisturbed(self, name: str) -> dict[str, Any]:
        """Also the memory that it takes at most beyond what it begins with, bytes of addresses."""
        return super().undisturbed(name) | {"memory": int((self.folder / name / "memory").read_text())}

    def _whole(self, name: str, out: Path) -> Ended:
        def program() -> None:
            begun = addresses("VmSize")
            try:
                TARGETS[name].run(self.given, out)
            finally:
                (self.folder / name / "memory").write_text(str(addresses("VmPeak") - begun))

        return run(program, self._said(out), self._surroundings(out))

    def case(self, name: str, condition: str, number: int, whole: dict[str, Any]) -> str | None:
        """What was wrong; None: nothing."""
        if condition == TWO:
            return self.of_two(name, number, whole)
        return self.of_condition(name, condition, number, whole)

    def of_condition(self, name: str, condition: str, number: int, whole: dict[str, Any]) -> str | None:
        """What was wrong; None: nothing."""
        target, given = TARGETS[name], CONDITIONS[condition]
        seed = [self.arguments.seed, list(TARGETS).index(name), list(CONDITIONS).index(condition), number]
        rng = np.random.default_rng(seed)
        out = self.folder / name / f"{condition.replace(' ', '-').replace('/', '')}-{number}" / given.folder
        given.before(out, whole["sum"], rng)
        surroundings = self._surroundings(out)
        if given.executed:
            ended = _executed(given, command(name, self.given, out), os.environ | surroundings)
        else:

            def program() -> None:
                given.on(whole, rng)
                target.run(self.given, out, stay=condition == "other folder")

            ended = run(program, self._said(out), surroundings)
        wrong = _end(ended, whole["code"], given.may)
        given.after(out)
        if wrong is None and given.says not in ended.err:
            wrong = f"it does not say `{given.says}`: {ended.err[-800:]}"
        if wrong is None and given.same:
            if ended.code != whole["code"]:
                again = self._whole(name, out)
                if again.code != whole["code"]:
                    return f"started again: exit code {again.code}: {again.err[-600:]}"
            if self._left(name, out) != whole["left"]:
                wrong = f"it leaves something else: see {out}"
        return wrong

    def of_two(self, name: str, number: int, whole: dict[str, Any]) -> str | None:
        """Two programs with the same --out: the second one says so and leaves, the first one is not disturbed."""
        moments = np.random.default_rng([self.arguments.seed, number]).uniform(0.2, 0.5, DRAWS) * whole["seconds"]
        return until_hit(lambda moment: self._second_at(moment, name, number, whole), moments)

    def _second_at(self, moment: float, name: str, number: int, whole: dict[str, Any]) -> str | None:
        target, out = TARGETS[name], self.fresh(name, f"two-{number}")
        first = Forked(functools.partial(target.run, self.given, out), self._said(out), self._surroundings(out))
        if first.wait(moment):
            return MISSED
        second = run(functools.partial(target.run, self.given, out), self._said(out).with_name("second"),
                     self._surroundings(out))  # fmt: skip
        first.wait(600.0)
        ends = first.ended(), second
        if sorted(ended.code for ended in ends) != [0, 2] and [ended.code for ended in ends] != [0, 0]:
            return f"exit codes {ends[0].code} and {ends[1].code}: {ends[0].err[-300:]} {ends[1].err[-300:]}"
        for ended in ends:
            if ended.code == 2 and not (ended.err.count("\n") == 1 and "in use by another program" in ended.err):
                return f"not one line that says so: {ended.err[-600:]}"
        if self._left(name, out) != whole["left"]:
            return f"it leaves something else: see {out}"
        return None if any(ended.code == 2 for ended in ends) else MISSED


def _executed(given: Condition, words: list[str], surroundings: dict[str, str]) -> Ended:
    surroundings = {name: value for name, value in surroundings.items() if name not in given.without}
    text = given.shell.format(shlex.join(words))
    done = subprocess.run(
        ["/bin/bash", "-c", text], env=surroundings | dict(given.surroundings), capture_output=True, check=False,
        timeout=600.0,
    )  # fmt: skip
    return Ended(done.returncode, *(part.decode(errors="replace") for part in (done.stdout, done.stderr)), 0.0)


def _end(ended: Ended, code: int, may: tuple[int, ...]) -> str | None:
    """What is wrong with how a program ended."""
    if ended.code not in (code, *may):
        return f"exit code {ended.code}: {ended.err[-800:]}"
    if "Traceback" in ended.err or "Error:" in ended.err:
        return f"a traceback: {ended.err[-800:]}"
    lines = ended.err.splitlines()
    if ended.code == 2 and not (lines and all(line.startswith(("error: ", "warning: ")) for line in lines)):
        return f"no clear line: {ended.err[-800:]}"
    if ended.code == 128 + signal.SIGPIPE and lines:
        return f"not quiet: {ended.err[-800:]}"
    return None


def parse(arguments: list[str] | None = None) -> MachineArguments:
    """The command line."""
    return tyro.cli(MachineArguments, args=arguments, description=__doc__)


def main(arguments: MachineArguments) -> int:
    """Runs what is not in the log yet; returns 0 if all was well, else 1."""
    store, mounts, folder = store_of(arguments, "machine"), own_mounts(), Path(tempfile.mkdtemp())
    try:
        with store:
            return _run(arguments, folder, store, mounts)
    finally:
        subprocess.run(["umount", *map(str, _mounted(folder))], capture_output=True, check=False)
        shutil.rmtree(folder, ignore_errors=True)


def _mounted(folder: Path) -> list[str]:
    mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    return [place for place in mounts if place.startswith(str(folder))]


def _run(arguments: MachineArguments, folder: Path, store: RowStore, mounts: bool) -> int:
    campaign = MachineCampaign(arguments, folder)
    campaign.prepare()
    cases = [
        (name, condition, number)
        for name in arguments.targets
        for condition in arguments.conditions
        if name in (LOCKED if condition == TWO else CONDITIONS[condition].targets)
        for number in range(arguments.count)
        if mounts or condition == TWO or not CONDITIONS[condition].needs_mounts
    ]
    if not mounts:
        print("warning: mounts of its own are not allowed here: full disks and read-only folders are left out")
    return campaign.work(cases, store, campaign.case)


if __name__ == "__main__":
    run_program(main, parse)
