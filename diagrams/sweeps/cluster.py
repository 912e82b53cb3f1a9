"""A Dask cluster with the face of the pool of this machine (diagrams/episodes/pool.py)."""

import asyncio
import functools
import hashlib
import logging
import math
import ssl
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self, TypeVar

from distributed import Client, Future, KilledWorker, Security, WorkerPlugin, as_completed, get_worker
from distributed import Worker as DaskWorker
from distributed.core import connect
from distributed.versions import VersionMismatchWarning
from tqdm import tqdm

from diagrams.episodes.fingerprint import VERSIONS, code_hash
from diagrams.episodes.pool import ATTEMPTS
from models.errors import InputError

J = TypeVar("J")
R = TypeVar("R")

PATIENCE = 20.0  # s, for a scheduler that does not answer
WAIT = 60.0  # s, for a cluster without workers, and for one whose scheduler was lost
LOOK = 0.05  # s between looks for what has been finished
MEMORY = 1.0e9  # bytes that a worker needs: 0.5e9 are used, and Dask pauses a worker at 80 % of its limit


class WeightFiles(WorkerPlugin):
    """Brings files to every worker, wherever it runs and whenever it starts."""

    def __init__(self, files: dict[str, bytes]):
        """`files`: name to content."""
        self.files = files
        contents = [(name, hashlib.sha256(content).hexdigest()) for name, content in sorted(files.items())]
        self.hash = hashlib.sha256(repr(contents).encode()).hexdigest()
        self.name = f"hindsight-{self.hash}"  # one that has another's name takes its place

    def setup(self, worker: DaskWorker) -> None:
        """Writes the files into the worker's scratch folder."""
        folder = _folder(worker, self.hash)
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)


def _folder(worker: DaskWorker, bundle: str) -> Path:
    return Path(worker.local_directory) / f"weights-{bundle[:16]}"


async def _require_answer(scheduler: str, patience: float, security: Security | None) -> None:
    """Raises OSError where nobody answers for `patience` seconds; Client waits for the first answer without end."""
    secure = {} if security is None else security.get_connection_args("client")
    try:
        comm = await asyncio.wait_for(connect(scheduler, timeout=patience, **secure), patience + 1.0)
    except TimeoutError as error:
        raise OSError(f"no answer for {patience:.0f} s") from error
    comm.abort()


class Unfit(RuntimeError):
    """A worker that must not run an episode; in words, with the remedy."""


@functools.cache
def versions() -> dict[str, str]:
    """Of what decides a row's bits, and of what driver and workers speak with each other, in this process."""
    found = {name: version(name) for name in (*VERSIONS, "distributed")}
    return found | {"Python": "{}.{}".format(*sys.version_info), "code": code_hash()}


def require_fit(driver: dict[str, str], dask_worker: DaskWorker) -> None:
    """Raises Unfit in a worker of other versions than `driver`, or with too little memory."""
    here = versions()
    for name in driver.keys() | here.keys():
        if driver.get(name) != here.get(name):
            raise Unfit(f"has {name} {here.get(name)}, the sweep {driver.get(name)}: bring both to the same")
    limit = getattr(dask_worker.memory_manager, "memory_limit", None)
    if limit and limit < MEMORY:
        raise Unfit(
            f"may use {limit / 1e9:.2f} GB of memory, an episode takes {MEMORY / 1e9:g}: give it more (--memory-limit)"
        )


class DaskPool:
    """Runs jobs on the workers of a running cluster; a context manager."""

    def __init__(self, scheduler: str, files: dict[str, bytes], tls: tuple[Path, Path, Path] | None = None):
        """`scheduler`: address, tcp://... or tls://...; `files`: brought to every worker.

        `tls`: files of the authority, of this side's certificate and of its key.

        Raises InputError where none answers, where there is no worker for WAIT seconds, and for a worker that differs
        in a version or has too little memory.
        """
        self._scheduler, self._files, self._security = scheduler, WeightFiles(files), None
        if tls is not None:
            authority, certificate, key = map(str, tls)
            self._security = Security(
                tls_ca_file=authority, tls_client_cert=certificate, tls_client_key=key, require_encryption=True
            )
            try:
                self._security.get_connection_args("client")
            except (OSError, ssl.SSLError) as error:
                raise InputError(
                    f"{authority}, {certificate} and {key} cannot be used for TLS ({error}): check the files"
                ) from error
        # What they have to say of a lost connection is said here, in one line.
        for name in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        warnings.simplefilter("ignore", VersionMismatchWarning)
        self._connect(PATIENCE)

    def _connect(self, patience: float) -> None:
        try:
            asyncio.run(_require_answer(self._scheduler, patience, self._security))
            self._client = Client(self._scheduler, timeout=patience, security=self._security)
        except (OSError, ValueError) as error:
            remedy = "check the address" if self._security is None else "check the address, and who signed --tls-cert"
            raise InputError(f"there is no Dask scheduler at {self._scheduler} ({error}): {remedy}") from error
        try:
            self._wait_for_workers()
            self._require_fit_workers()
            self._client.register_plugin(self._files)
        except BaseException:
            self._client.close()
            raise

    def _workers(self) -> list[str]:
        return sorted(self._client.scheduler_info()["workers"])

    def _wait_for_workers(self) -> None:
        """Raises InputError where there is none for WAIT seconds."""
        end, said = time.monotonic() + WAIT, False
        while not self._workers():
            if time.monotonic() > end:
                raise InputError(
                    f"the cluster at {self._scheduler} has had no worker for {WAIT:.0f} s: start some "
                    f"(dask worker {self._scheduler}), then the same command goes on"
                )
            if not said:
                tqdm.write(f"waiting for a worker at {self._scheduler}, {WAIT:.0f} s at most ...", file=sys.stderr)
                said = True
            time.sleep(0.5)

    def _require_fit_workers(self) -> None:
        unfit = self._client.run(require_fit, versions(), on_error="return")
        for worker, error in sorted(unfit.items()):
            if isinstance(error, Unfit):
                raise InputError(f"the worker {worker} {error}")
            if isinstance(error, ImportError | AttributeError):
                raise InputError(
                    f"the worker {worker} cannot run this program ({error}): start it in this version's environment"
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()

    def with_files(self, function: Callable[[Path, J], R]) -> Callable[[J], R]:
        """`function` with the worker's folder of the files as its first argument."""
        return partial(_call_with_files, function, self._files.hash, versions())

    def run(
        self, function: Callable[[J], R], jobs: Iterable[J], given_up: Callable[[J, BaseException], R] | None = None
    ) -> Iterator[tuple[J, R]]:
        """Yields each job with `function(job)`, as they come; a job that the cluster gave up does not come.

        `function`: of a module that the workers can import; what it raises is raised here. `given_up` gives the result
        of a job under which more workers died than the scheduler allows; None: KilledWorker is raised. A scheduler that
        was lost is waited for, and what it had is asked for again, ATTEMPTS times in all.

        Raises InputError as the constructor, also later: for a worker that comes, and where the last one goes.
        """
        lost = list(jobs)
        for attempt in range(ATTEMPTS):
            if attempt:
                self._client.close()
                tqdm.write(f"the scheduler at {self._scheduler} was lost: connecting again ...", file=sys.stderr)
                self._connect(WAIT)
            lost = yield from self._run(function, lost, given_up)
            if not lost:
                return

    def _run(self, function, jobs, given_up):
        """As `run`; returns the jobs that were lost with the scheduler."""
        lost = []
        futures = self._client.map(function, jobs, pure=False)
        asked = dict(zip((future.key for future in futures), jobs, strict=True))
        # Only what is under way is kept: a result that was taken is let go.
        completed = as_completed(futures, loop=self._client.loop)
        del futures
        for future in self._watched(completed):
            job = asked[future.key]
            if future.status in ("lost", "pending"):  # its worker died before the result was fetched: it is run again
                completed.add(future)
                continue
            if future.status == "cancelled":
                lost.append(job)
                continue
            if future.status == "error":
                error = future.exception()
                if isinstance(error, Unfit):
                    raise InputError(str(error)) from error
                if given_up is None or not isinstance(error, KilledWorker):
                    raise error
                result = given_up(job, error)
            else:
                try:
                    result = future.result()
                except CancelledError:  # the scheduler was lost while it was fetched
                    lost.append(job)
                    continue
            yield job, result
            future.release()
        return lost

    def _watched(self, completed: as_completed) -> Iterator[Future]:
        """As they come; raises InputError where there has been no worker for WAIT seconds."""
        looked = -math.inf
        while not completed.is_empty():
            if completed.has_ready():
                yield next(completed)
            elif time.monotonic() - looked > 5.0 and self._client.status == "running":
                self._wait_for_workers()
                looked = time.monotonic()
            else:
                time.sleep(LOOK)


def _call_with_files(function: Callable[[Path, Any], R], bundle: str, driver: dict[str, str], job: Any) -> R:
    worker = get_worker()
    try:
        require_fit(driver, worker)  # one that came later
    except Unfit as error:
        raise Unfit(f"the worker {worker.address} {error}") from None
    return function(_folder(worker, bundle), job)
