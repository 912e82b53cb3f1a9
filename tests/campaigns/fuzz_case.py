"""One case in a forked child: its folder, its limits, its words, and whether it was answered well.

The parent has imported everything; the child runs the program's own `main`. What a program starts once its input is
accepted (simulations, workers, updates, pages, pictures) ends the child with ACCEPTED: the input was answered.
"""

import hashlib
import os
import re
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

ACCEPTED = 77  # exit code of a case whose input was taken
SECONDS, BYTES = 10, 2 * 1024**3  # of processor time and of memory that an answer may take
LOADED = 600 * 1024**2  # of BYTES, for what a program imports; the campaign itself, of which a case is a fork, has more
HANG = 40.0  # s of wall time after which a case hangs; more than SECONDS, for a machine that is busy
REMEDY = re.compile(
    r"\b(add|allow|call|change|check|choose|close|delete|expected one of|export|fit again|fit it|free|give|install|"
    r"known|leave|let|lower|make|pass|perhaps|put|raise|record|remove|run|say|see|start|swap|take|teach|train|try|"
    r"update|wait|widen|write)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Special:
    """No plain file: kind "fifo", "folder", "zero" (a link to /dev/zero), "sparse" (`head`, zeros up to `size`)."""

    kind: str
    head: bytes = b""
    size: int = 0

    def make(self, path: Path) -> None:
        """Makes it."""
        if self.kind == "fifo":
            os.mkfifo(path)
        elif self.kind == "folder":
            path.mkdir()
        elif self.kind == "zero":
            path.symlink_to("/dev/zero")
        else:
            path.write_bytes(self.head)
            os.truncate(path, self.size)


@dataclass(frozen=True)
class Case:
    """Arguments for a program and the files that they speak of, names relative to the folder it runs in."""

    subject: str
    program: str  # key of PROGRAMS in fuzz.py
    argv: list[str]
    files: dict[str, bytes | Special] = field(default_factory=dict)
    names: tuple[str, ...] = ()  # one of which the refusal has to name; (): whatever it says

    @property
    def command(self) -> str:
        """For people."""
        import shlex

        return " ".join([self.program, *(shlex.quote(part) for part in self.argv)])


@dataclass
class Answer:
    """How a case ended; `wrong` says what is not as it should be, None: nothing."""

    code: int
    cpu_s: float
    mib: float
    words: str  # on stderr
    wrong: str | None = None


def lay_out(case: Case, folder: Path) -> dict[str, str]:
    """Writes the files of the case into the empty `folder`; the hash of each plain one by its name."""
    hashes = {}
    for name, content in case.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Special):
            content.make(path)
        else:
            path.write_bytes(content)
            hashes[name] = hashlib.sha256(content).hexdigest()
    return hashes


def answer(case: Case, main: Callable[[list[str]], NoReturn], folder: Path) -> Answer:
    """Runs `main(argv)` in a child in `folder`, which is emptied before, and judges it."""
    shutil.rmtree(folder, ignore_errors=True)
    inside = folder / "here"
    inside.mkdir(parents=True)
    hashes = lay_out(case, inside)
    before, inherited = _listing(inside), _resident()
    pid = os.fork()
    if not pid:
        _child(case, main, inside, folder)
    status, usage, hung = _wait(pid)
    words = (folder / "stderr").read_text(errors="replace") if (folder / "stderr").exists() else ""
    code = os.waitstatus_to_exitcode(status)
    taken = (LOADED + 1024 * usage.ru_maxrss - inherited) / 1024**2
    found = Answer(code, usage.ru_utime + usage.ru_stime, taken, words)
    changed = [n for n, h in hashes.items() if not _same(inside / n, h) and (code == 2 or not n.startswith("out"))]
    left = sorted(_listing(inside) - before) if code == 2 else []
    found.wrong = "hangs" if hung else _wrong(case, found, changed, left)
    return found


def _child(case: Case, main: Callable[[list[str]], NoReturn], inside: Path, folder: Path) -> NoReturn:
    code = 70
    try:
        os.setsid()
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        # As a process of its own begins: pytest, for one, has put others into their place.
        sys.stdout = open(1, "w", closefd=False, errors="surrogateescape")  # noqa: SIM115
        sys.stderr = open(2, "w", closefd=False, errors="backslashreplace", buffering=1)  # noqa: SIM115
        os.chdir(inside)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (size + BYTES, size + BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 2, SECONDS + 4))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        main(case.argv)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def accept(*_: object, **__: object) -> NoReturn:
    """Takes the place of what a program starts once its input is accepted."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(ACCEPTED)


def _wait(pid: int) -> tuple[int, resource.struct_rusage, bool]:
    """Status, usage, and whether the child had to be killed; what it started goes with it."""
    end, hung, pause = time.monotonic() + HANG, False, 0.002
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > end:
            hung = True
            with suppress(ProcessLookupError):  # it has just ended
                os.killpg(pid, signal.SIGKILL)
        time.sleep(pause)
        pause = min(pause * 1.3, 0.02)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)  # children of the child
    return status, usage, hung


def _resident() -> int:
    """Bytes of this process that are in the machine's memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _listing(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}


def _same(path: Path, digest: str) -> bool:
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest


def _wrong(case: Case, found: Answer, changed: list[str], left: list[str]) -> str | None:
    if "Traceback (most recent call last)" in found.words:
        return "traceback: " + found.words.strip().splitlines()[-1][:200]
    if found.code not in (0, 1, 2, ACCEPTED):
        return f"exit code {found.code}"
    if found.cpu_s > SECONDS:
        return f"takes {found.cpu_s:.0f} s"
    if found.mib * 1024**2 > BYTES:
        return f"takes {found.mib:.0f} MiB"
    if changed:
        return f"changes {', '.join(changed)}"
    if left:
        return f"leaves {', '.join(left)}"
    if found.code != 2:
        return None
    lines = [line for line in found.words.splitlines() if line.strip() and not line.startswith("warning: ")]
    if len(lines) != 1 or not lines[0].startswith("error: "):
        return f"says {len(lines)} lines where one begins with error:"
    if not REMEDY.search(lines[0]):
        return "names no remedy"
    told = {" ".join(name.encode(errors="backslashreplace").decode().split()) for name in case.names}
    if told and not any(name.replace("-", "") in lines[0].replace("-", "") for name in told):
        return f"names none of {', '.join(case.names)}"[:200]
    return None
