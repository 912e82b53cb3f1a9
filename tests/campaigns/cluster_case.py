"""A Dask cluster in other processes and a sweep on it, which cluster.py lets a fault befall; and what is well."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from models.command_line import ROOT
from tests.campaigns.network import Network

SWEEP = Path(__file__).with_name("cluster_sweep.py")
TIMES = ("wall_seconds", "realtime_factor")  # a row's columns that no two runs share
PATIENCE = 300.0  # s, for anything
EPISODES = 6  # of each disturbance (none, B)


@dataclass
class ClusterArguments:
    """Runs cases."""

    seed: int = 0
    count: int = 26
    faults: list[str] = field(default_factory=list)  # these alone
    out: Path = Path("outputs/campaigns/cluster")


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
        for number in range(self.network.hosts):
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
            "--scheduler", self.address, "--episodes", EPISODES, "--seed", self.arguments.seed,
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
        wait_for(lambda: log.read_text().count("Register worker") >= self.network.hosts, "workers")

    def any_worker(self) -> int:
        """The seed decides which."""
        return int(self.rng.integers(self.network.hosts))

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


def free_port() -> int:
    """A port of the loopback address."""
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
