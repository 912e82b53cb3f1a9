"""How every program begins and ends: arguments in, exit code out; bad input is one clear line and exit code 2."""

import contextlib
import errno
import importlib.util
import io
import multiprocessing
import os
import re
import resource
import select
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from models import interrupts
from models.errors import InputError

# Which extra of pyproject.toml brings a module.
EXTRAS = {
    "train": ("h5py", "onnx", "onnxscript", "torch"),
    "files": ("av", "foxglove"),
    "gym": ("gymnasium",),
    "sweep": ("dask", "distributed", "pandas", "pyarrow", "scipy", "sklearn"),
    "analysis": ("cmaes", "optuna"),
    "monitors": ("pyod",),
    "live": ("bokeh", "tornado"),
}
_MEMORY = "free some, or take fewer --workers"
_PLACE = "choose another place, or make it writable"
_NAME = "choose another name"
# What the machine refuses, and what helps. Other errors of the system are faults of the program.
REMEDIES = {
    errno.ENOSPC: "make room there, or choose another place", errno.EDQUOT: "make room there, or choose another place",
    errno.EFBIG: "raise the limit of a file's size (ulimit -f)", errno.EIO: "check the disk",
    errno.EACCES: _PLACE, errno.EPERM: _PLACE, errno.EROFS: _PLACE,
    errno.ENOENT: _NAME, errno.ENOTDIR: _NAME, errno.EISDIR: _NAME, errno.ENAMETOOLONG: _NAME, errno.EEXIST: _NAME,
    errno.EMFILE: "raise the limit of open files (ulimit -n), or take fewer --workers",
    errno.ENFILE: "raise the limit of open files (ulimit -n), or take fewer --workers",
    errno.ENOMEM: _MEMORY, errno.EAGAIN: "raise the limit of processes (ulimit -u), or take fewer --workers",
}  # fmt: skip
# What torch, Drake, Python and the loader of libraries say, under types that say nothing of it.
_OF_MACHINE = {
    r"can't allocate memory|out of memory|failed to map segment": f"there is not enough memory: {_MEMORY}",
    r"can't start new thread|Resource temporarily": f"no thread can be started: {REMEDIES[errno.EAGAIN]}",
}
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
LEAST_STACK = 4 << 20  # bytes; an episode crashes with 1 MiB, and runs with 2
ROOT = Path(__file__).resolve().parents[1]  # of the checkout


def run(main: Callable[[Any], int], arguments: Callable[[], Any]) -> NoReturn:
    """Ends the process with the exit code of `main(arguments())`.

    Bad input, and what the machine refuses (a full disk, a folder that cannot be written, ...), is one line on stderr
    and exit code 2; Ctrl-C and SIGTERM are one line and 130 or 143. A pipe that nobody reads any more: 141, quietly.
    """
    _open_streams()
    # Of the locks of workers that were killed; said by a process of its own, which has these options too.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    with interrupts.listening():
        try:
            require_checkout()
            require_stack()
            try:
                code = main(_parsed(arguments))
            except Exception:
                interrupts.leave_if_asked()  # a library took the request to end for a failure of its own
                raise
        except SystemExit as end:  # --help, and the parser's own errors
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except InputError as error:
            code = _bad_input(_words(error))
        except ModuleNotFoundError as absent:
            extra = next((e for e, names in EXTRAS.items() if (absent.name or "").split(".")[0] in names), None)
            if extra is None:
                raise
            code = _bad_input(f"this needs {absent.name}: pip install -e '.[{extra}]'")
        except BrokenPipeError:
            if not _reader_gone():  # another pipe than the output's
                raise
            code = 128 + signal.SIGPIPE  # as if ended by it: what was to be done is not done
        except OSError as error:
            if error.errno not in REMEDIES and error.filename is None:
                raise
            code = _bad_input(_of_machine(error))
        except MemoryError as error:
            code = _bad_input(_words(error, f"there is not enough memory: {_MEMORY}"))
        except (ImportError, RuntimeError) as error:
            told = next((words for said, words in _OF_MACHINE.items() if re.search(said, str(error))), None)
            if told is None:
                raise
            code = _bad_input(told)
        except KeyboardInterrupt as end:
            code = 128 + getattr(end, "number", signal.SIGINT)
            with suppress(KeyboardInterrupt):  # pressed again, from the line on
                for worker in multiprocessing.active_children():
                    worker.kill()  # it is not waited for: what it does is not finished
                kept = "; ".join(getattr(end, "__notes__", ())) or "start it again"
                say(f"{interrupts.ENDED}: {kept}")
                _let_threads_end()
        code = _flush() or code
    sys.exit(code)


def _let_threads_end() -> None:
    """Waits a second at most for the threads that led the workers.

    At its exit Python wakes them: one that is just closing what it is woken by would be a traceback there.
    """
    end = time.monotonic() + 1.0
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(max(end - time.monotonic(), 0.0))


def _parsed(arguments: Callable[[], Any]) -> Any:
    """`arguments()`; what the parser says in a frame of several lines becomes one."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            parsed = arguments()
    except SystemExit as end:
        if end.code != 2:
            raise
        lines = [_COLOUR.sub("", line).strip("│ ") for line in said.getvalue().splitlines()]
        # Its rules are of minus signs where the output has no others.
        words = " ".join(";" if line[:3] in ("───", "---") else line for line in lines if line[:1] not in ("╭", "╰"))
        raise InputError(words.replace(" ;", ";") or "the arguments do not fit: see --help") from None
    if sys.stderr is not None:  # closed by whoever started the program
        sys.stderr.write(said.getvalue())
    return parsed


def _open_streams() -> None:
    """What was closed by whoever started the program is the null device; no character ends the program."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)  # gets that number, which else the next file would have
            os.set_inheritable(null, True)
            setattr(sys, name, open(null, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115
    # A terminal may have no plus-minus sign; a refused name has to be told, whatever its bytes are.
    for stream, errors in ((sys.stdout, "replace"), (sys.stderr, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=errors)


def _flush() -> int:
    """Writes what is left of the output; an exit code where that cannot be done, else 0."""
    code = 0
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:  # whoever read it has had enough: what is left goes nowhere
            pass
        except OSError as error:
            code = _bad_input(_of_machine(error))
        else:
            continue
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return code


def _reader_gone() -> bool:
    """Whether the output is a pipe that nobody reads any more."""
    poll = select.poll()
    for stream in (sys.stdout, sys.stderr):
        poll.register(stream, select.POLLOUT)
    return any(state & select.POLLERR for _, state in poll.poll(0))


def _of_machine(error: OSError) -> str:
    """What the machine refused, in words."""
    where = "the output" if error.filename is None else f"{str(error.filename)!r:.200}".strip("'")
    number = error.errno or 0
    return _words(error, f"{where}: {os.strerror(number)}: {REMEDIES.get(number, _NAME)}")


def _words(error: BaseException, text: str | None = None) -> str:
    """The error in words, with its notes."""
    return "; ".join([str(error) if text is None else text, *getattr(error, "__notes__", ())])


def require(*modules: str, extra: str | None = None) -> None:
    """Raises ModuleNotFoundError for one of `modules` that is not installed, before hours of work end in that.

    With `extra`, which brings all of them, an InputError that names it: some modules are in several.
    """
    for name in modules:
        if importlib.util.find_spec(name) is None:
            if extra is not None:
                raise InputError(f"this needs {name}: pip install -e '.[{extra}]'")
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)


def require_checkout() -> None:
    """Raises InputError where the packages were installed without -e: `sdf/` and the weights stayed behind."""
    if not (ROOT / "sdf").is_dir():
        raise InputError(
            f"{ROOT} holds neither sdf/ nor the weights: install with `pip install -e .`, in an environment of its own"
        )


def require_stack() -> None:
    """Raises InputError where the stack is limited to less than LEAST_STACK: the simulation would crash."""
    least, _ = resource.getrlimit(resource.RLIMIT_STACK)
    if least != resource.RLIM_INFINITY and least < LEAST_STACK:
        raise InputError(f"the stack is limited to {least // 1024} kB, too little: raise the limit (ulimit -s 8192)")


def require_writable(path: Path) -> None:
    """Raises InputError unless the file `path`, which is left as it is, can be written; before work is done for it."""
    try:
        if path.is_fifo() or path.is_socket():  # to open it may hang
            raise InputError(f"{path} is a pipe, no plain file: give another name")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            path.open("ab").close()
        else:
            tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another name") from error


def _bad_input(words: str) -> int:
    say(f"error: {words}")
    return 2


def say(words: str) -> None:
    """One line on stderr, if there is anybody to read it; what would steer a terminal is written out."""
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in " ".join(words.split()))
    with suppress(OSError):
        print(plain, file=sys.stderr, flush=True)
