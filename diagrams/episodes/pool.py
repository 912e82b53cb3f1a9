"""The one pool: jobs over worker processes of this machine. A cluster has the same face (diagrams/sweeps/cluster.py).

Each worker is a process of its own that runs one job at a time. So a worker that dies takes one job with it, which is
run again by a fresh worker; a job under which workers die again and again is given up. A worker that has run many jobs
makes way for a fresh one: each Context that has rendered leaves some kilobytes in Drake's renderer.
"""

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from queue import Empty, SimpleQueue
from typing import Any, Self, TypeVar

from models import interrupts
from models.errors import InputError
from models.files.container import naming

MOST_WORKERS = 1000
ATTEMPTS = 3  # of a job under which workers die
JOBS_A_WORKER = 500  # 500 episodes leave 9 MB (tests/campaigns/soak.py)
LISTENS_EVERY = 0.2  # s: for a request to end
J = TypeVar("J")
R = TypeVar("R")
T = TypeVar("T")


class WorkerDied(InputError):
    """A job under which so many workers died: more often for want of memory than for what is in it."""


class Pool:
    """Runs jobs on `workers` processes; a context manager. With 0 workers the jobs run in the calling thread."""

    def __init__(self, workers: int):
        """Raises InputError for a number of workers outside of 0 to MOST_WORKERS."""
        if not 0 <= workers <= MOST_WORKERS:
            raise InputError(f"the number of workers {workers} is out of range: choose from 0 to {MOST_WORKERS}")
        self._workers, self._idle = workers, SimpleQueue[ProcessPoolExecutor]()
        self._unmade, self._making = workers, threading.Lock()  # a worker is made when there is a job for it
        self._ran = Counter[ProcessPoolExecutor]()  # jobs

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        while not self._idle.empty():
            self._idle.get().shutdown(wait=error is None, cancel_futures=True)

    def run(
        self, function: Callable[[J], R], jobs: Iterable[J], given_up: Callable[[J, WorkerDied], R] | None = None
    ) -> Iterator[tuple[J, R]]:
        """Yields each job with `function(job)`, as they come; what that raises is raised here.

        `function`: of a module that can be imported. `given_up` gives the result of a job under which ATTEMPTS workers
        died; None: WorkerDied is raised. No more jobs are handed out than there are workers: a consumer that stops
        early leaves the others unbegun. May be called from several threads.

        Raises Interrupted where the program is asked to end; what is finished by then is yielded first.
        """
        if not self._workers:
            for job in jobs:
                interrupts.leave_if_asked()
                result = function(job)
                with interrupts.held():
                    yield job, result
            return
        with interrupts.held():
            yield from self._run(function, jobs, given_up)

    def _run(
        self, function: Callable[[J], R], jobs: Iterable[J], given_up: Callable[[J, WorkerDied], R] | None
    ) -> Iterator[tuple[J, R]]:
        waiting = deque((job, 1) for job in jobs)
        running: dict[Future, tuple[ProcessPoolExecutor, J, int]] = {}
        try:
            while waiting or running:
                while waiting and not interrupts.asked() and (worker := self._take(not running)) is not None:
                    job, attempt = waiting.popleft()
                    try:
                        future = _submit(worker, function, job)
                    except BrokenProcessPool:  # it died while it had nothing to do
                        worker = _worker()
                        future = _submit(worker, function, job)
                    running[future] = worker, job, attempt
                finished = wait(running, LISTENS_EVERY, return_when=FIRST_COMPLETED).done
                if not finished:
                    interrupts.leave_if_asked()
                for future in finished:
                    worker, job, attempt = running.pop(future)
                    died = isinstance(future.exception(), BrokenProcessPool)
                    self._idle.put(self._after_job(worker, died))
                    if not died:
                        yield job, future.result()
                    elif attempt < ATTEMPTS:
                        waiting.append((job, attempt + 1))
                    else:
                        gone = WorkerDied(f"{ATTEMPTS} workers died in a row while they ran this job")
                        if given_up is None:
                            gone.add_note(
                                "give each worker 1 GB of memory or more, or take fewer; then the same command goes on"
                            )
                            raise gone
                        yield job, given_up(job, gone)
        except interrupts.Interrupted:
            running.clear()  # nobody waits for them
            raise
        finally:
            for future, (worker, _, _) in running.items():
                # Waits: a worker is handed back when it is free.
                self._idle.put(self._after_job(worker, isinstance(future.exception(), BrokenProcessPool)))

    def _take(self, block: bool) -> ProcessPoolExecutor | None:
        try:
            return self._idle.get_nowait()
        except Empty:
            pass
        with self._making:
            if self._unmade:
                self._unmade -= 1
                return _worker()
        try:
            return self._idle.get(block, LISTENS_EVERY)
        except Empty:
            return None

    def _after_job(self, worker: ProcessPoolExecutor, died: bool) -> ProcessPoolExecutor:
        """`worker`, which has run one more, or a fresh one in its place."""
        self._ran[worker] += 1
        if not died and self._ran[worker] < JOBS_A_WORKER:
            return worker
        del self._ran[worker]
        if not died:
            worker.shutdown()
        return _worker()


def _worker() -> ProcessPoolExecutor:
    with naming("/dev/shm"):  # whence the locks between processes come
        return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _submit(worker: ProcessPoolExecutor, function: Callable[[J], R], job: J) -> "Future[R]":
    """Ctrl-C at a terminal is told every process: here it is the parent's alone, and a worker does not hear of it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which a process begins with
    try:
        future = worker.submit(function, job)
        # Its end of the pipe of results, which it never writes to: as long as it is open, what a worker was killed in
        # the middle of is waited for without end.
        worker._result_queue._writer.close()  # type: ignore[attr-defined]
        return future
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """In a fresh worker: one thread a library, since the processes share the cores; an end with its parent."""
    os.environ["OMP_NUM_THREADS"] = "1"  # before OpenMP starts

    def end_with_parent() -> None:
        multiprocessing.parent_process().join()  # type: ignore[union-attr]
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


_thread = threading.local()


def kept_in_thread(key: Hashable, make: Callable[[], T], most: int = 1) -> T:
    """What `make` made in this thread for `key`: made once, and kept for the next jobs, the `most` last of a kind.

    The first entry of a `key` that is a tuple is its kind. A thread, not a process: a renderer belongs to the thread
    that made it.
    """
    kind = key[0] if isinstance(key, tuple) else key
    kept: dict[Any, Any] = _thread.__dict__.setdefault(f"kept_{kind}", {})
    if key not in kept:
        while len(kept) >= most:
            del kept[next(iter(kept))]  # the oldest
        kept[key] = make()
    return kept[key]
