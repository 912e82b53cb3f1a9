"""What the machine may be like: each condition is put upon the process that a program runs in, or upon its folder."""

import ctypes
import os
import resource
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

CLONE_NEWNS, PR_CAPBSET_DROP, CAPABILITIES_3 = 0x00020000, 24, 0x20080522
OVERRIDING = (1, 2, 3)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, CAP_FOWNER
PAGE = 4096


@dataclass(frozen=True)
class Condition:
    """`on`: in the process, before the program; it is given what is known of an undisturbed run. `before`, `after`: of
    the folder `out`, around it; `before` is given the sum of all that the program leaves undisturbed, bytes.
    `executed`: in a Python of its own, with `surroundings`. `may`: exit codes beside that of an undisturbed run.
    """

    on: Callable[[dict[str, Any], np.random.Generator], None] = lambda whole, rng: None
    before: Callable[[Path, int, np.random.Generator], None] = lambda out, size, rng: None
    after: Callable[[Path], None] = lambda out: None
    executed: bool = False
    surroundings: tuple[tuple[str, str], ...] = ()
    without: tuple[str, ...] = ()  # surroundings that are not there
    shell: str = "{}"  # around the command
    may: tuple[int, ...] = (2,)
    says: str = ""  # on stderr
    targets: tuple[str, ...] = ("sweep", "teach", "rnn", "calibrate", "return", "pick_place", "bench")
    same: bool = True  # what it leaves is what an undisturbed run leaves
    folder: str = "out"  # name of the folder `out`
    needs_mounts: bool = False


def own_mounts() -> bool:
    """Gives this process mounts of its own; whether that is allowed."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNS) != 0:
        return False
    return subprocess.run(["mount", "--make-rprivate", "/"], capture_output=True, check=False).returncode == 0


def addresses(name: str) -> int:
    """Of this process, as /proc names them, bytes."""
    return int(Path("/proc/self/status").read_text().partition(f"{name}:")[2].split()[0]) * 1024


def _mount(*words: object) -> None:
    subprocess.run(["mount", *map(str, words)], check=True, capture_output=True)


def _fill(out: Path, size: int, rng: np.random.Generator) -> None:
    """A disk with a random part of the room that is needed."""
    out.mkdir(parents=True)
    _mount("-t", "tmpfs", "-o", f"size={PAGE * (1 + rng.integers(max(size // PAGE, 1)))}", "none", out)


def _read_only(out: Path, size: int, rng: np.random.Generator) -> None:
    out.mkdir(parents=True)
    _mount("--bind", out, out)
    _mount("-o", "remount,ro,bind", out)


def _of_another(out: Path, size: int, rng: np.random.Generator) -> None:
    out.mkdir(parents=True)
    os.chown(out, 65534, 65534)


def _no_overriding(whole: dict[str, Any], rng: np.random.Generator) -> None:
    """Root's right to write in anybody's folder is given up."""
    libc = ctypes.CDLL(None, use_errno=True)
    for bit in OVERRIDING:
        libc.prctl(PR_CAPBSET_DROP, bit, 0, 0, 0)
    header = (ctypes.c_uint32 * 2)(CAPABILITIES_3, 0)
    data = (ctypes.c_uint32 * 6)()
    libc.capget(header, data)
    for place in (0, 1, 2):
        data[place] &= ~sum(1 << bit for bit in OVERRIDING)
    if libc.capset(header, data) != 0:
        raise OSError(ctypes.get_errno(), "capset")


def _file_size(whole: dict[str, Any], rng: np.random.Generator) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(rng.integers(1, whole["largest"])),) * 2)


def _open_files(whole: dict[str, Any], rng: np.random.Generator) -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))


def _memory(whole: dict[str, Any], rng: np.random.Generator) -> None:
    """Half of what it takes beyond its libraries."""
    resource.setrlimit(resource.RLIMIT_AS, (addresses("VmSize") + whole["memory"] // 2,) * 2)


def _no_locks(whole: dict[str, Any], rng: np.random.Generator) -> None:
    """Read-only shared memory."""
    own_mounts()
    _mount("-o", "remount,ro,bind", "/dev/shm")


def _no_graphviz(whole: dict[str, Any], rng: np.random.Generator) -> None:
    """Nor the command of the package that takes its place, which lies beside this Python."""
    os.environ["PATH"] = "/nowhere"
    sysconfig.get_path = lambda *_, **__: "/nowhere"


def _elsewhere(whole: dict[str, Any], rng: np.random.Generator) -> None:
    os.chdir("/")


# In each Python that begins, so in workers too.
CLOCK_BACK = (
    "d=$(mktemp -d); trap 'rm -r $d' EXIT; export PYTHONPATH=$d:$PYTHONPATH; "
    "echo 'import time; now = time.time; time.time = lambda: now() - 86400.0' > $d/sitecustomize.py; {}"
)
# Drake 1.51.1 cannot be imported where Python reads files as ASCII (PYTHONUTF8=0, PYTHONCOERCECLOCALE=0).
ASCII = (("LC_ALL", "C"), ("LANG", "C"), ("PYTHONIOENCODING", "ascii"))
# Not baselines: what it is given lies where it writes.
OUT_OF_ROOM = ("teach", "teach-lerobot", "cae", "rnn", "recall", "calibrate", "sweep", "sweep-blocked", "falsify",
                "return", "resume", "defeat", "bench", "export", "coverage", "pick_place")  # fmt: skip
CONDITIONS = {
    "full disk": Condition(before=_fill, after=lambda out: _mount("-o", "remount,size=2g", out),
                           targets=OUT_OF_ROOM, needs_mounts=True),
    "file size": Condition(on=_file_size, targets=OUT_OF_ROOM),
    "read-only": Condition(before=_read_only, after=lambda out: _mount("-o", "remount,rw,bind", out),
                           targets=OUT_OF_ROOM, needs_mounts=True),
    "another's folder": Condition(before=_of_another, on=_no_overriding),
    "read-only /dev/shm": Condition(on=_no_locks, targets=("sweep", "teach", "return"), needs_mounts=True),
    "open files": Condition(on=_open_files, may=()),
    "memory": Condition(on=_memory, targets=("cae", "rnn", "recall", "sweep", "bench")),
    "clock back": Condition(executed=True, shell=CLOCK_BACK, may=()),
    "other folder": Condition(on=_elsewhere, may=()),
    "name": Condition(folder="eine Größe, 木の棚", may=()),
    "no HOME": Condition(executed=True, without=("HOME",), may=()),
    "no TMPDIR": Condition(executed=True, surroundings=(("TMPDIR", "/nowhere"),), may=()),
    "LANG=C": Condition(executed=True, surroundings=ASCII, folder="eine Größe", may=()),
    "closed streams": Condition(executed=True, shell="{} >&- 2>&-"),
    "full output": Condition(executed=True, shell="{} > /dev/full"),
    "pipe": Condition(executed=True, shell="set -o pipefail; {} | head -n 1", may=(141,)),
    "64 threads": Condition(executed=True, surroundings=(("OMP_NUM_THREADS", "64"),), same=False, may=()),
    "no EGL": Condition(executed=True, surroundings=(("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere.json"),),
                        targets=("pick_place",)),
    "no Graphviz": Condition(on=_no_graphviz, may=(), targets=("pick_place",), same=False,
                             says="warning: the diagram could not be drawn: there is no program `dot`"),
}  # fmt: skip


def command(name: str, given: Path, out: Path) -> list[str]:
    """That runs a target in a Python of its own."""
    code = "import sys; from pathlib import Path; from tests.campaigns.targets import TARGETS; "
    code += "name, *folders = sys.argv[1:]; TARGETS[name].run(*map(Path, folders))"
    # As arguments: code with letters that the machine's language does not have is no code to Python.
    return [sys.executable, "-c", code, name, str(given), str(out)]
