"""Faults of a Dask cluster while it runs a sweep: its rows must be those of this machine, or it refuses in one line.

    python tests/campaigns/cluster.py --seed 0 --count 26

A real scheduler and three workers in other processes, each in a network of its own where this machine allows it (Linux,
root), run real episodes of 8 s. Case i has fault i of FAULTS, modulo their number, at a moment that `--seed` decides;
`--faults` takes the cases of these alone. Started again it runs what is missing. Exit code 1: a case was not answered
well.
"""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import tyro
from tqdm import tqdm

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.sampling import SEED_BLOCKS
from diagrams.episodes.store import RowStore
from diagrams.world.configuration import World
from models.checks import require_numbers
from models.command_line import ROOT, run
from models.errors import InputError
from tests.campaigns.cluster_case import EPISODES, SWEEP, Bad, Case, ClusterArguments, rows_of, stored
from tests.campaigns.network import Network

WORKERS = 3
HANG = 60.0  # s, of a worker that hangs


def parse(arguments: list[str] | None = None) -> ClusterArguments:
    """The command line."""
    return tyro.cli(ClusterArguments, args=arguments, description=__doc__)


def worker_killed(case: Case) -> str:
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    case.worker_process(case.any_worker()).kill()
    return case.finish(driver)


def nanny_killed(case: Case) -> str:
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    os.killpg(case.workers[case.any_worker()].pid, signal.SIGKILL)
    return case.finish(driver)


def worker_hung(case: Case) -> str:
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    group = case.workers[case.any_worker()].pid
    os.killpg(group, signal.SIGSTOP)
    time.sleep(HANG)
    os.killpg(group, signal.SIGCONT)
    return case.finish(driver)


def worker_cut_off(case: Case) -> str:
    if not case.network.apart:
        return "not run: there are no network namespaces here"
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    case.network.cut(1 + case.any_worker())
    return case.finish(driver)


def scheduler_restarted(case: Case) -> str:
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    assert case.scheduler is not None
    case.scheduler.kill()
    case.scheduler.wait()
    time.sleep(case.rng.uniform(0.0, 5.0))
    case.start_scheduler()
    return case.finish(driver, starts=2)


def driver_killed(case: Case) -> str:
    case.start_all()
    for _ in range(2):
        driver = case.start_driver()
        case.moment(driver)
        driver.kill()
        driver.wait()
        if stored(case.rows) > len(case.reference) // 2:
            break
    return case.finish(case.start_driver())


def all_workers_leave(case: Case) -> str:
    case.start_all()
    driver = case.start_driver()
    case.moment(driver)
    for worker in case.workers:
        os.killpg(worker.pid, signal.SIGKILL)
    for worker in case.workers:
        worker.wait()
    time.sleep(case.rng.uniform(0.0, 10.0))
    return case.finish(driver)


def encrypted(case: Case) -> str:
    case.scheme = "tls"
    case.start_all()
    return case.finish(case.start_driver())


def another_authority(case: Case) -> str:
    case.scheme = "tls"
    case.start_all()
    return case.refused(case.start_driver("another"), "no Dask scheduler at tls://", "who signed --tls-cert")


def another_version(case: Case) -> str:
    name, words = [("numpy", "numpy"), ("drake", "drake"), ("onnxruntime", "onnxruntime")][int(case.rng.integers(3))]
    path = case.folder / "site" / f"{name}-9.9.9.dist-info"
    path.mkdir(parents=True)
    (path / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 9.9.9\n")
    case.start_scheduler()
    for number in range(case.network.hosts):
        case.start_worker(number, **({"PYTHONPATH": f"{path.parent}:{ROOT}"} if number == 1 else {}))
    case.wait_for_workers()
    return case.refused(case.start_driver(), f"has {words} 9.9.9, the sweep")


def another_program(case: Case) -> str:
    copy = case.folder / "copy"
    for path in [
        *ROOT.glob("sdf/**/*"),
        *(p for room in ("diagrams", "models", "systems", "tests") for p in ROOT.glob(f"{room}/**/*.py")),
    ]:
        if path.is_file():
            (copy / path.relative_to(ROOT)).parent.mkdir(parents=True, exist_ok=True)
            (copy / path.relative_to(ROOT)).write_bytes(path.read_bytes())
    with (copy / "systems" / "alpha_mixer.py").open("a") as file:
        file.write("# another\n")
    case.start_scheduler()
    for number in range(case.network.hosts):
        case.start_worker(number, **({"PYTHONPATH": str(copy)} if number == 1 else {}))
    case.wait_for_workers()
    return case.refused(case.start_driver(), "has code ", "the sweep ")


def little_memory(case: Case) -> str:
    case.start_scheduler()
    for number in range(case.network.hosts):
        case.start_worker(number, "0.5GB" if number == case.network.hosts - 1 else "2GB")
    case.wait_for_workers()
    return case.refused(case.start_driver(), "may use 0.50 GB of memory", "--memory-limit")


def no_workers(case: Case) -> str:
    case.start_scheduler()
    words = case.refused(case.start_driver(), "has had no worker for 60 s")
    if "waiting for a worker" not in case.said(10):
        raise Bad("it waited in silence")
    return words


FAULTS: tuple[Callable[[Case], str], ...] = (
    worker_killed, nanny_killed, worker_hung, worker_cut_off, scheduler_restarted, driver_killed, all_workers_leave,
    encrypted, another_authority, another_version, another_program, little_memory, no_workers,
)  # fmt: skip


def write_authorities(out: Path) -> None:
    """Two authorities with a certificate each, as files."""
    from distributed import Security

    for name in ("ours", "another"):
        (out / name).mkdir(exist_ok=True)
        made = Security.temporary()
        for part, content in (("ca", made.tls_ca_file), ("cert", made.tls_client_cert), ("key", made.tls_client_key)):
            (out / name / f"{part}.pem").write_text(content)


def here(arguments: ClusterArguments) -> dict[str, dict]:
    """The rows of this machine's own workers."""
    out = arguments.out / "here"
    done = subprocess.run(
        [sys.executable, str(SWEEP), "--episodes", str(EPISODES), "--seed", str(arguments.seed),
         "--disturbance", "none", "B", "--out", str(out.resolve()), "--workers", "2"],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise InputError(f"the sweep of this machine itself failed: {done.stderr[-300:]}")
    return rows_of(out / "rows.jsonl")


def run_case(arguments: ClusterArguments, number: int, reference: dict[str, dict]) -> dict:
    """Its row: whether it was answered well, what was said, s."""
    fault, began = FAULTS[number % len(FAULTS)], time.monotonic()
    folder = next(path for k in range(1000) if not (path := arguments.out.resolve() / f"case{number}-{k}").exists())
    rng = np.random.default_rng([arguments.seed, number])
    with Network(WORKERS) as network, Case(arguments, folder, network, rng, reference) as case:
        try:
            words, well = fault(case), True
        except Bad as bad:
            words, well = str(bad), False
    return {"fault": fault.__name__, "well": well, "words": words, "seconds": round(time.monotonic() - began, 1)}


def _asked_for(arguments: ClusterArguments) -> Callable[[int], bool]:
    """Whether the case of that number has a fault that is asked for."""
    names = [fault.__name__ for fault in FAULTS]
    for name in arguments.faults:
        if name not in names:
            raise InputError(f"there is no fault '{name}': choose from {', '.join(names)}")
    return lambda number: names[number % len(names)] in (arguments.faults or names)


def main(arguments: ClusterArguments) -> int:
    """Runs the cases that are missing; returns the exit code."""
    require_numbers(arguments, {"seed": (0, SEED_BLOCKS - 1), "count": (1, 10**6)})
    numbers = list(itertools.islice(filter(_asked_for(arguments), itertools.count()), arguments.count))
    made_with = fingerprint(World(), "diagrams/sweeps", "tests/campaigns", seed=arguments.seed)
    with RowStore(arguments.out / "cases.jsonl", made_with) as store:
        write_authorities(arguments.out)
        reference = here(arguments)
        missing = [number for number in numbers if str(number) not in store.rows]
        for number in tqdm(missing, total=len(numbers), initial=len(numbers) - len(missing), unit="case", disable=None):
            row = run_case(arguments, number, reference)
            store.add(str(number), row)
            word = "well" if row["well"] else "BADLY"
            tqdm.write(f"{number} {row['fault']}: {word}, {row['seconds']:.0f} s: {row['words']}")
        well = sum(store.rows[str(number)]["well"] for number in numbers)
    print(f"{well} of {arguments.count} answered well")
    return int(well < arguments.count)


if __name__ == "__main__":
    run(main, parse)
