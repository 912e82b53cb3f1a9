"""Feeds every program bad input, and counts what is answered well.

    python tests/campaigns/fuzz.py --seed 0 --count 10000

Well: exit code 0, 1 or 2; for 2 one line on stderr that begins with "error: " and names value, limit and remedy; no
traceback; no file of the user's changed, and none left behind by a refusal; within 10 s of processor time and 2 GiB.
Input that is accepted ends where a program would start its work (see WORK).

The same seed gives the same inputs. Started again with the same --out it goes on. A case that is not answered well is
kept in OUT/SEED/failed/NUMBER with its files and command; `--only NUMBER` runs it again. Exit code 1: some are not.
"""

import importlib
import json
import os
import pickle
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "Agg"

import tyro  # noqa: E402

from models.checks import LARGEST_SEED, require_numbers  # noqa: E402
from models.command_line import run  # noqa: E402
from tests.campaigns.fuzz_case import ACCEPTED, Answer, Case, accept, answer  # noqa: E402

# Modules by the names that cases give their programs.
PROGRAMS = {
    name: f"diagrams.{name}"
    for name in ("pick_place", "teach", "calibrate", "baselines", "bench", "sweep", "figures", "analysis", "live")
} | {"training": "models.training.__main__"}
# What a program does once its input is accepted: workers, updates, samples, simulations, pages, pictures.
WORK = (
    "diagrams.episodes.pool:Pool.run", "torch.optim:Adam.step", "diagrams.episodes.rollout:Rollout.run",
    "diagrams.episodes.rollout:Rollout.prepare", "diagrams.browser.server:serve", "matplotlib.figure:Figure.savefig",
    "diagrams.hybrid.switching_point:subtask_images", "diagrams.hybrid.defeat:Climb.run",
    "models.training.probe:regress", "models.training.export:quantised",
)  # fmt: skip
BUFFER = 20_000  # bytes of chance a case


@dataclass
class FuzzArguments:
    """Command line of fuzz.py."""

    seed: int = 0
    count: int = 10_000  # cases
    only: int | None = None  # this one alone, with what it says
    subject: str | None = None  # only cases whose subject begins so
    out: Path = Path("outputs/campaigns/fuzz")


def parse(arguments: list[str] | None = None) -> FuzzArguments:
    """The command line."""
    return tyro.cli(FuzzArguments, args=arguments, description=__doc__)


def import_all() -> None:
    """Imports all that the programs import: the children need not."""
    for name in ("pydrake.all", "torch", "torch._dynamo", "onnx", "pandas", "pyarrow.parquet", "scipy.stats",
    "sklearn.decomposition",
                 "sklearn.model_selection", "matplotlib.pyplot", "bokeh.models", "foxglove", "av", "optuna",
                 "cmaes"):  # fmt: skip
        importlib.import_module(name)
    rooms = [ROOT / "models", ROOT / "systems", ROOT / "diagrams"]
    for path in (path for room in rooms for path in sorted(room.rglob("*.py"))):
        importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))


def leave_work_out() -> None:
    """Puts `accept` into the place of the programs' work."""
    for spec in WORK:
        module, _, name = spec.partition(":")
        owner: Any = importlib.import_module(module)
        *inside, last = name.split(".")
        for part in inside:
            owner = getattr(owner, part)
        setattr(owner, last, accept)
    rnn: Any = importlib.import_module("models.training.rnn")
    rnn.policy_graph = lambda *_: None  # seconds for a trial that no input decides


def in_child(make: Callable[[], Any]) -> Any:
    """What `make` makes, in a process of its own: this one stays without threads, so that it can be forked."""
    with tempfile.NamedTemporaryFile() as file:
        if not (pid := os.fork()):
            file.write(pickle.dumps(make()))
            file.flush()
            os._exit(0)
        if os.waitpid(pid, 0)[1]:
            raise RuntimeError("the files that the inputs are made from could not be made")
        return pickle.loads(Path(file.name).read_bytes())


class Inputs:
    """The cases of a seed, by their number; their subjects take turns."""

    def __init__(self, seed: int) -> None:
        from tests.campaigns import fuzz_bases, fuzz_bench, fuzz_files, fuzz_inputs, fuzz_weights, fuzz_yaml

        self.seed, bases = seed, in_child(fuzz_bases.make_bases)
        lines = [fuzz_inputs.command_lines(name, program, bases) for name, program in fuzz_inputs.programs().items()]
        texts = [fuzz_yaml.worlds(bases), fuzz_yaml.scenarios(bases)] * 3
        files = [fuzz_weights.weights(bases)] * 4 + [fuzz_files.demonstrations(bases)] * 2
        files += [fuzz_files.records(bases)] * 2 + [fuzz_files.sweeps(bases)] * 2 + [fuzz_files.checkpoints(bases)] * 2
        files += [fuzz_bench.benches(bases)] * 2 + [fuzz_bench.exports(bases), fuzz_bench.runs(bases)]
        self.strategies = [*lines, *texts, *files, fuzz_weights.autoencoders(bases)]

    def __getitem__(self, number: int) -> Case:
        from hypothesis import HealthCheck, given, settings

        found: list[Case] = []
        quiet = settings(database=None, deadline=None, suppress_health_check=list(HealthCheck))

        @quiet
        @given(self.strategies[number % len(self.strategies)])
        def taken(case: Case) -> None:
            found.append(case)

        for attempt in range(100):
            taken.hypothesis.fuzz_one_input(random.Random(f"{self.seed} {number} {attempt}").randbytes(BUFFER))
            if found:
                return found[0]
        raise RuntimeError(f"no case {number} could be drawn")


def main_of(program: str) -> Callable[[list[str]], NoReturn]:
    """Runs the program of that name as its `python FILE` would."""
    module = importlib.import_module(PROGRAMS[program])

    def started(argv: list[str]) -> NoReturn:
        sys.argv = [program, *argv]
        run(module.main, module.parse)

    return started


def keep(case: Case, found: Answer, made: Path, folder: Path) -> None:
    """Keeps a case that was not answered well."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in case.files:
        if (made / name).is_file() and (made / name).stat().st_size < 1e8:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(made / name, folder / name)
    text = f"{case.subject}\n{case.command}\n\n{found.wrong}\nexit code {found.code}, {found.cpu_s:.1f} s\n\n"
    (folder / "case.txt").write_text(text + found.words[-5000:], errors="backslashreplace")


def main(arguments: FuzzArguments) -> int:
    """Runs the cases that the log does not hold yet; returns the exit code."""
    from tqdm import tqdm

    from diagrams.episodes.fingerprint import code_hash
    from diagrams.episodes.store import RowStore

    require_numbers(arguments, {"seed": (0, LARGEST_SEED), "count": (1, 10**6), "only": (0, 10**6)})
    import_all()
    inputs = Inputs(arguments.seed)
    leave_work_out()
    out = arguments.out / str(arguments.seed)
    scratch = Path(tempfile.mkdtemp(prefix="fuzz"))
    if arguments.only is not None:
        case = inputs[arguments.only]
        found = answer(case, main_of(case.program), scratch)
        print(f"in {scratch}/here: {case.command!a}\nexit code {found.code}, {found.cpu_s:.1f} s, {found.mib:.0f} MiB")
        print(f"{found.words.encode(errors='backslashreplace').decode()}\n{found.wrong or 'answered well'}")
        return 1 if found.wrong else 0
    made_with = {"seed": arguments.seed, "code": code_hash("models", "diagrams", "tests/campaigns")}
    with RowStore(out / "log.jsonl", made_with) as store:
        numbers = [number for number in range(arguments.count) if str(number) not in store.rows]
        for number in tqdm(numbers, unit="case", disable=None):
            case = inputs[number]
            if arguments.subject and not case.subject.startswith(arguments.subject):
                continue
            found = answer(case, main_of(case.program), scratch)
            if found.wrong:
                keep(case, found, scratch / "here", out / "failed" / str(number))
                tqdm.write(f"{number}: {case.subject}: {found.wrong!a}")
            row = {"subject": case.subject, "code": found.code, "wrong": found.wrong, "words": found.words[:300]}
            row = json.loads(json.dumps(row | {"cpu_s": found.cpu_s, "mib": found.mib}, default=str))
            store.add(str(number), row)
        rows = [row for number, row in store.rows.items() if int(number) < arguments.count]
    shutil.rmtree(scratch)
    return report(rows)


def report(rows: list[dict[str, Any]]) -> int:
    """Prints how each subject was answered, and the count last; returns the exit code."""
    subjects = Counter(row["subject"] for row in rows)
    print(f"{'subject':32} {'cases':>6} {'accepted':>9} {'exit 0':>7} {'exit 1':>7} {'exit 2':>7} {'not well':>9}")
    for subject in sorted(subjects):
        codes = Counter(row["code"] for row in rows if row["subject"] == subject)
        bad = sum(row["wrong"] is not None for row in rows if row["subject"] == subject)
        print(f"{subject:32} {subjects[subject]:6} {codes[ACCEPTED]:9} {codes[0]:7} {codes[1]:7} {codes[2]:7} {bad:9}")
    slowest, largest = (max((row[name] for row in rows), default=0.0) for name in ("cpu_s", "mib"))
    print(
        f"at most {slowest:.1f} s of processor time and {largest:.0f} MiB; {sum(r['cpu_s'] for r in rows):.0f} s in all"
    )
    well = sum(row["wrong"] is None for row in rows)
    print(f"{well} of {len(rows)} answered well")
    return 0 if well == len(rows) else 1


if __name__ == "__main__":
    run(main, parse)
