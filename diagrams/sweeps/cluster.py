"""A Dask cluster with the face of the pool of this machine (diagrams/episodes/pool.py)."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

from distributed import Client, WorkerPlugin, as_completed, get_worker
from distributed import Worker as DaskWorker

from models.errors import InputError

J = TypeVar("J")
R = TypeVar("R")


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


class DaskPool:
    """Runs jobs on the workers of a running cluster; a context manager."""

    def __init__(self, scheduler: str, files: dict[str, bytes]):
        """`scheduler`: address, tcp://...; `files`: brought to every worker. Raises InputError where none answers."""
        self._files = WeightFiles(files)
        try:
            self._client = Client(scheduler, timeout=20)
        except (OSError, ValueError) as error:
            raise InputError(f"there is no Dask scheduler at {scheduler} ({error}): check the address") from error
        self._client.register_plugin(self._files)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()

    def with_files(self, function: Callable[[Path, J], R]) -> Callable[[J], R]:
        """`function` with the worker's folder of the files as its first argument."""
        return partial(_call_with_files, function, self._files.hash)

    def run(
        self, function: Callable[[J], R], jobs: Iterable[J], given_up: Callable[[J, BaseException], R] | None = None
    ) -> Iterator[tuple[J, R]]:
        """Yields each job with `function(job)`, as they come; a job that the cluster gave up does not come.

        `function`: of a module that the workers can import. `given_up` gives the result of a job that raised, or under
        which more workers died than the scheduler allows; None: that is raised.
        """
        jobs = list(jobs)
        futures = self._client.map(function, jobs, pure=False)
        asked = dict(zip((future.key for future in futures), jobs, strict=True))
        # Only what is under way is kept: a result that was taken is let go.
        completed = as_completed(futures)
        del futures
        for future in completed:
            job = asked[future.key]
            if future.status in ("lost", "pending"):  # its worker died before the result was fetched: it is run again
                completed.add(future)
                continue
            if future.status == "error" and given_up is not None:
                yield job, given_up(job, future.exception())
            elif future.status in ("finished", "error"):
                yield job, future.result()
            future.release()


def _call_with_files(function: Callable[[Path, Any], R], bundle: str, job: Any) -> R:
    return function(_folder(get_worker(), bundle), job)
