"""Faults of a Dask cluster while it runs a sweep: its rows must be those of this machine, or it refuses in one line.

    python tests/campaigns/cluster.py --seed 0 --count 26

A real scheduler and three workers in other processes, each in a network of its own where this machine allows it (Linux,
root), run real episodes of 8 s. Case i has fault i of FAULTS, modulo their number, at a moment that `--seed` decides.
Started again it runs what is missing. Exit code 1: a case was not answered well.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import psutil
import tyro
from tqdm import tqdm

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.store import RowStore
from diagrams.world.configuration import World
from models.command_line import ROOT, run
from models.errors import InputError
from tests.campaigns.network import Network

SWEEP = Path(__file__).with_name("cluster_sweep.py")
TIMES = ("wall_seconds", "realtime_factor")  # a row's columns that no two runs share
PATIENCE = 300.0  # s, for anything
WORKERS = 3


@dataclass
class ClusterArguments:
    """Runs cases."""

    seed: int = 0
    count: int = 26
    out: Path = Path("outputs/campaign_cluster")
    episodes: int = 6  # of each disturbance (none, B)
    hang: float = 60.0  # s, of a worker that hangs


def parse(arguments: list[str] | None = None) -> ClusterArguments:
    """The command line."""
    return tyro.cli(ClusterArguments, args=arguments, description=__doc__)


class Bad(AssertionError):
    """What was not answered well, in words."""


@dataclass
class Case:
    """A cluster and a driver, under one fault."""

    arguments: ClusterArguments
    folder: Path
    network: Network
    rng: np.random.Generator
    reference: dict[str, dict]
    scheme: str = "tcp"
    started: list[subprocess.Popen] = field(default_factory=list)
    scheduler: subprocess.Popen | None = None
    workers: list[subprocess.Popen] = field(default_factory=list)
    starts: int = 0  # of the driver

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return f"{self.scheme}://{self.network.address(0)}:{self.port}"

    @property
    def rows(self) -> Path:
        """Where the driver stores."""
        return self.folder / "out" / "rows.jsonl"

    def start(self, name: str, host: int, *words: object, **environment: str) -> subprocess.Popen:
        """A process group on `host`, its output in the file `name`."""
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(
                [*self.network.on(host), sys.executable, *map(str, words)],
                stdout=log, stderr=log, stdin=subprocess.DEVNULL, cwd=self.folder, start_new_session=True,
                env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"} | environment,
            )  # fmt: skip
        self.started.append(process)
        return process

    def start_scheduler(self) -> None:
        """At the same address as one before."""
        words = ("--host", f"{self.scheme}://{self.network.address(0)}", "--port", self.port, "--no-dashboard")
        self.scheduler = self.start(
            "scheduler", 0, "-m", "distributed.cli.dask_scheduler", *words, *self.tls("tls-ca-file")
        )

    def start_worker(self, number: int, memory: str = "2GB", **environment: str) -> None:
        """On a host of its own."""
        host = number + 1
        words = (
            self.address, "--host", f"{self.scheme}://{self.network.address(host)}", "--nthreads", 1, "--no-dashboard",
            "--memory-limit", memory, "--local-directory", self.folder / f"scratch{number}",
        )  # fmt: skip
        process = self.start(
            f"worker{number}",
            host,
            "-m",
            "distributed.cli.dask_worker",
            *words,
            *self.tls("tls-ca-file"),
            **environment,
        )
        self.workers[number : number + 1] = [process]

    def start_all(self) -> None:
        """The scheduler and three workers."""
        self.start_scheduler()
        for number in range(WORKERS):
            self.start_worker(number)

    def tls(self, ca_option: str, folder: str = "ours") -> list[object]:
        """Options of TLS; the authority's has another name in Dask's programs."""
        files = self.folder.parent / folder
        options = {ca_option: "ca", "tls-cert": "cert", "tls-key": "key"}
        given = [(f"--{option}", files / f"{name}.pem") for option, name in options.items()]
        return [word for pair in given for word in pair] if self.scheme == "tls" else []

    def start_driver(self, authority: str = "ours") -> subprocess.Popen:
        """The sweep; the same command each time."""
        self.starts += 1
        words = (
            "--scheduler", self.address, "--episodes", self.arguments.episodes, "--seed", self.arguments.seed,
            "--disturbance", "none", "B", "--out", self.folder / "out", *self.tls("tls-ca", authority),
        )  # fmt: skip
        return self.start("driver", 0, SWEEP, *words)

    def moment(self, driver: subprocess.Popen) -> None:
        """Waits until some of the episodes, the seed decides how many, are stored."""
        count = 1 + int(self.rng.integers(1, len(self.reference) // 2))
        wait_for(lambda: driver.poll() is not None or stored(self.rows) >= count, "rows")
        if driver.poll() is not None:
            raise Bad(f"the sweep ended with {driver.returncode} before the fault: {self.said()}")
        time.sleep(self.rng.uniform(0.0, 1.0))

    def worker_process(self, number: int) -> psutil.Process:
        """That runs the episodes; its parent is Dask's nanny."""
        children = psutil.Process(self.workers[number].pid).children(recursive=True)
        return next(c for c in children if "spawn_main" in " ".join(c.cmdline()))

    def wait_for_workers(self) -> None:
        """Until all of them have been seen by the scheduler."""
        log = self.folder / "scheduler.log"
        wait_for(lambda: log.read_text().count("Register worker") >= WORKERS, "workers")

    def any_worker(self) -> int:
        """The seed decides which."""
        return int(self.rng.integers(WORKERS))

    def finish(self, driver: subprocess.Popen, starts: int = 1) -> str:
        """Waits for the end; raises Bad unless it stored the rows of this machine, each once."""
        wait_for(lambda: self.supervise() or driver.poll() is not None, "the sweep's end")
        while driver.returncode != 0 and self.starts < starts:
            driver = self.start_driver()
            wait_for(lambda driver=driver: self.supervise() or driver.poll() is not None, "the sweep's end")
        if driver.returncode != 0:
            raise Bad(f"exit code {driver.returncode} at start {self.starts}: {self.said()}")
        have, lines = rows_of(self.rows), stored(self.rows)
        if have != self.reference:
            differing = [key for key in self.reference if have.get(key) != self.reference[key]]
            raise Bad(f"{len(differing)} rows are not those of this machine: {differing[:3]}")
        if lines != len(self.reference):
            raise Bad(f"{lines} rows were stored for {len(self.reference)} episodes")
        return f"{lines} rows as on this machine, {self.starts} starts of the sweep"

    def supervise(self) -> None:
        """Starts workers that ended anew, as whoever runs a cluster does."""
        for number, worker in enumerate(self.workers):
            if worker.poll() is not None:
                self.start_worker(number)

    def refused(self, driver: subprocess.Popen, *named: str) -> str:
        """Waits for the end; raises Bad unless it refused in one line with what is `named`, and stored nothing."""
        wait_for(lambda: driver.poll() is not None, "the sweep's end")
        errors = [line for line in self.said(10).splitlines() if line.startswith("error:")]
        if driver.returncode != 2 or len(errors) != 1 or "Traceback" in self.said(1000):
            raise Bad(f"exit code {driver.returncode}, {len(errors)} lines of error: {self.said()}")
        if absent := [words for words in named if words not in errors[0]]:
            raise Bad(f"{absent} is not in: {errors[0]}")
        if stored(self.rows):
            raise Bad(f"{stored(self.rows)} rows were stored")
        return errors[0]

    def said(self, lines: int = 3) -> str:
        """The end of what the sweep wrote."""
        return "\n".join((self.folder / "driver.log").read_text().replace("\r", "\n").splitlines()[-lines:])

    def __enter__(self) -> "Case":
        self.folder.mkdir(parents=True)
        self.port = 8786 if self.network.apart else free_port()
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.started:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


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
    time.sleep(case.arguments.hang)
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
    for number in range(WORKERS):
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
    for number in range(WORKERS):
        case.start_worker(number, **({"PYTHONPATH": str(copy)} if number == 1 else {}))
    case.wait_for_workers()
    return case.refused(case.start_driver(), "has code ", "the sweep ")


def little_memory(case: Case) -> str:
    case.start_scheduler()
    for number in range(WORKERS):
        case.start_worker(number, "0.5GB" if number == WORKERS - 1 else "2GB")
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


def free_port() -> int:
    """A port of the loopback address."""
    import socket

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def wait_for(done: Callable[[], object], what: str) -> None:
    """Raises Bad after PATIENCE."""
    end = time.monotonic() + PATIENCE
    while not done():
        if time.monotonic() > end:
            raise Bad(f"waited {PATIENCE:.0f} s for {what}")
        time.sleep(0.05)


def stored(rows: Path) -> int:
    """Lines that hold a row."""
    return max(0, rows.read_bytes().count(b"\n") - 1) if rows.exists() else 0


def rows_of(path: Path) -> dict[str, dict]:
    """Rows by key, without their times."""
    entries = [json.loads(line) for line in path.read_text().splitlines()[1:]]
    return {e["key"]: {name: value for name, value in e["row"].items() if name not in TIMES} for e in entries}


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
        [sys.executable, str(SWEEP), "--episodes", str(arguments.episodes), "--seed", str(arguments.seed),
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


def main(arguments: ClusterArguments) -> int:
    """Runs the cases that are missing; returns the exit code."""
    asked = {name: getattr(arguments, name) for name in ("seed", "episodes", "hang")}
    with RowStore(arguments.out / "cases.jsonl", fingerprint(World(), "diagrams/sweeps", **asked)) as store:
        write_authorities(arguments.out)
        reference = here(arguments)
        numbers = range(arguments.count)
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
