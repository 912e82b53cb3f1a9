"""How every program begins and ends: arguments in, exit code out; bad input is one clear line and exit code 2."""

import importlib.util
import os
import select
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

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
ROOT = Path(__file__).resolve().parents[1]  # of the checkout


def run(main: Callable[[Any], int], arguments: Callable[[], Any]) -> NoReturn:
    """Ends the process with the exit code of `main(arguments())`; 2, after one line on stderr, for an InputError."""
    try:
        require_checkout()
        code = main(arguments())
    except SystemExit as end:  # --help, and the parser's own errors
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except InputError as error:
        code = _bad_input(str(error))
    except ModuleNotFoundError as absent:
        extra = next((e for e, names in EXTRAS.items() if (absent.name or "").split(".")[0] in names), None)
        if extra is None:
            raise
        code = _bad_input(f"this needs {absent.name}: pip install -e '.[{extra}]'")
    except BrokenPipeError:
        if not _reader_gone():  # another pipe than the output's
            raise
        code = 141  # as if ended by SIGPIPE: what was to be done is not done
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    try:
        if sys.stdout is not None:  # closed by whoever started the program
            sys.stdout.flush()
    except BrokenPipeError:  # whoever read it has had enough: what is left goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _reader_gone() -> bool:
    """Whether the output is a pipe that nobody reads any more."""
    poll = select.poll()
    poll.register(sys.stdout, select.POLLOUT)
    return any(state & select.POLLERR for _, state in poll.poll(0))


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


def require_writable(path: Path) -> None:
    """Raises InputError unless the file `path`, which is left as it is, can be written; before work is done for it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            path.open("ab").close()
        else:
            tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another name") from error


def _bad_input(words: str) -> int:
    print(f"error: {' '.join(words.split())}", file=sys.stderr)
    return 2
