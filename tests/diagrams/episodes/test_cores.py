"""The number of cores is what affinity and container leave."""

import math
import os

import pytest

from diagrams import teach
from diagrams.episodes import cores as module
from diagrams.episodes.cores import cores, quota
from diagrams.sweeps.plan import SweepArguments


@pytest.fixture
def mount(tmp_path):
    """Control groups, and a file that says in which of them this process is: write(groups, {file: content})."""

    def write(groups, files):
        (tmp_path / "proc").write_text(groups)
        for name, content in files.items():
            (tmp_path / "mount" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "mount" / name).write_text(content)
        return tmp_path / "proc", tmp_path / "mount"

    return write


@pytest.mark.parametrize(
    ("groups", "files", "left"),
    [
        ("0::/a/b\n", {"a/b/cpu.max": "150000 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n", "a/cpu.max": "300000 100000\n"}, 3.0),  # of the group around it
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n"}, math.inf),
        ("0::/\n", {"cpu.max": "50000 100000\n"}, 0.5),  # as a container sees it
        ("4:memory:/x\n1:cpu:/x\n0::/\n", {"cpu/x/cpu.cfs_quota_us": "200000", "cpu/x/cpu.cfs_period_us": "100000"}, 2),
        ("1:cpu,cpuacct:/docker/1\n", {"cpu,cpuacct/cpu.cfs_quota_us": "-1", "cpu,cpuacct/cpu.cfs_period_us": "9"},
         math.inf),
        ("1:cpu,cpuacct:/docker/1\n", {"cpu,cpuacct/cpu.cfs_quota_us": "70", "cpu,cpuacct/cpu.cfs_period_us": "10"}, 7),
        ("1:cpuset:/x\n", {"cpuset/x/cpu.cfs_quota_us": "1", "cpuset/x/cpu.cfs_period_us": "1"}, math.inf),
        ("0::/a\n", {"a/cpu.max": "much\n"}, math.inf),
        ("0::/../a\n", {}, math.inf),
    ],
)  # fmt: skip
def test_quota(mount, groups, files, left):
    assert quota(*mount(groups, files)) == left


def test_no_control_groups(tmp_path):
    assert quota(tmp_path / "none", tmp_path) == math.inf


@pytest.mark.parametrize(("left", "count"), [(0.2, 1), (1.5, 2), (math.inf, 8)])
def test_cores(monkeypatch, left, count):
    for name in ("process_cpu_count", "cpu_count"):
        monkeypatch.setattr(os, name, lambda: 8, raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(module, "quota", lambda: left)
    assert cores() == count


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity on this system")
def test_affinity_is_the_default_of_workers():
    whole = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(whole)})
        assert SweepArguments().workers == teach.TeachArguments("x.h5").workers == 1
    finally:
        os.sched_setaffinity(0, whole)
