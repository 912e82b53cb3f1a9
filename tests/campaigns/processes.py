"""Programs in processes of their own, forked after the imports; and what is left of them."""

import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import thread
from dataclasses import dataclass
from pathlib import Path

from models import interrupts


@dataclass
class Ended:
    """How a process ended: exit code (negative: by that signal), and what it said."""

    code: int
    out: str
    err: str
    seconds: float


class Forked:
    """`program` in a process and a process group of its own, what it says in files of `folder`."""

    def __init__(self, program: Callable[[], object], folder: Path, surroundings: dict[str, str] | None = None):
        folder.mkdir(parents=True, exist_ok=True)
        self._said, self.begun = [folder / name for name in ("stdout.txt", "stderr.txt")], time.monotonic()
        self.pid = os.fork()
        if not self.pid:
            self._become(program, surroundings or {})
        self.code: int | None = None

    def _become(self, program: Callable[[], object], surroundings: dict[str, str]) -> None:
        code = 1
        thread._threads_queues.clear()  # of the parent's pool of threads, which are not here
        try:
            os.setsid()
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            for number, path in enumerate(self._said, start=1):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), number)
                setattr(sys, ("stdout", "stderr")[number - 1], open(number, "w", closefd=False))  # noqa: SIM115
            signal.signal(signal.SIGINT, signal.default_int_handler)
            # What the campaign's own program has heard and holds back is not this one's.
            interrupts._State.running, interrupts._State.asked, interrupts._State.blocks = False, None, 0
            os.environ.update(surroundings)
            program()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:
            sys.excepthook(*sys.exc_info())  # as Python ends where nobody caught it
        finally:
            try:
                threading._shutdown()
                atexit._run_exitfuncs()
                for stream in (sys.stdout, sys.stderr):
                    if stream is not None:
                        stream.flush()
            finally:
                os._exit(code)  # whatever happened: never on into what the parent does

    def poll(self) -> bool:
        """Whether it has ended."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.code = os.waitstatus_to_exitcode(status) if pid else None
        return self.code is not None

    def wait(self, seconds: float) -> bool:
        """Whether it has ended within so many seconds."""
        return until(self.poll, seconds)

    def ends_within(self, patience: float) -> float | None:
        """Seconds until it and all of its group have ended, less the longest that one of them waited for a processor.

        So that a busy machine is no slow program. None: more than `patience`, or a minute in all.
        """
        begun, first, waited = time.monotonic(), dict[int, float](), 0.0
        while True:
            members = self.members()
            for pid in members:
                so_far = _waited(pid)
                waited = max(waited, so_far - first.setdefault(pid, so_far))
            passed = time.monotonic() - begun
            if self.poll() and not members:
                return passed - waited
            if passed - waited > patience or passed > 60.0:
                return None
            time.sleep(0.01)

    def members(self) -> list[int]:
        """Processes of its group that still run."""
        found = []
        for entry in os.listdir("/proc"):
            if entry.isdigit():
                try:
                    fields = Path("/proc", entry, "stat").read_text().rsplit(")", 1)[1].split()
                except OSError:
                    continue
                if int(fields[2]) == self.pid and fields[0] != "Z":
                    found.append(int(entry))
        return found

    def workers(self) -> list[int]:
        """Its worker processes."""
        found = []
        for pid in self.members():
            try:
                words = Path("/proc", str(pid), "cmdline").read_bytes()
            except OSError:
                continue
            if pid != self.pid and b"spawn_main" in words:
                found.append(pid)
        return found

    def kill(self) -> None:
        """All of the group, at once."""
        try:
            os.killpg(self.pid, signal.SIGKILL)
        except ProcessLookupError:
            return

    def ended(self) -> Ended:
        """How it ended."""
        assert self.code is not None
        out, err = (path.read_text(errors="replace") for path in self._said)
        return Ended(self.code, out, err, time.monotonic() - self.begun)


def _waited(pid: int) -> float:
    """Seconds that the process's first thread has waited for a processor; 0 where the system does not tell."""
    try:
        return int(Path("/proc", str(pid), "schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0


def until(condition: Callable[[], bool], seconds: float) -> bool:
    """Whether `condition` came to hold within so many seconds."""
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.005)
    return found


def run(program: Callable[[], object], folder: Path, surroundings: dict[str, str] | None = None) -> Ended:
    """`program` from beginning to end, at most ten minutes."""
    process = Forked(program, folder, surroundings)
    if not process.wait(600.0):
        process.kill()
        process.wait(10.0)
    return process.ended()
