"""How many processor cores this process may use."""

import math
import os
from pathlib import Path


def cores() -> int:
    """At least 1: of its affinity, and of the quota of its container (cgroup 1 or 2)."""
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on
        count = os.process_cpu_count()
    elif hasattr(os, "sched_getaffinity"):
        count = len(os.sched_getaffinity(0))
    else:
        count = os.cpu_count()
    return max(1, math.ceil(min(count or 1, quota())))


def quota(proc: Path = Path("/proc/self/cgroup"), mount: Path = Path("/sys/fs/cgroup")) -> float:
    """Cores that the control groups of this process leave it, the smallest; infinity without a limit."""
    try:
        groups = [line.split(":", 2)[1:] for line in proc.read_text().splitlines()]
    except OSError:  # no Linux
        return math.inf
    least = math.inf
    for controllers, path in groups:
        if controllers and "cpu" not in controllers.split(","):
            continue
        root = mount / controllers
        # A group obeys those around it too; inside a container `path` may be what it is called outside.
        for folder in (root / path.lstrip("/"), *(root / path.lstrip("/")).parents):
            if folder.is_relative_to(root):
                least = min(least, _of_group(folder))
    return least


def _of_group(folder: Path) -> float:
    try:
        if (folder / "cpu.max").exists():  # cgroup 2
            used, period = (folder / "cpu.max").read_text().split()
        else:
            used, period = ((folder / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
        return math.inf if used in ("max", "-1") else int(used) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return math.inf
