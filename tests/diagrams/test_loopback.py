"""What the programs serve, they serve on this machine alone: read from their sockets while they run."""

import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import psutil

from models.command_line import ROOT
from tests.diagrams.browser.test_live import Program
from tests.diagrams.untrained import save_untrained

LOOPBACK = {"127.0.0.1", "::1"}
PATIENCE = 100.0  # s; a few on a free machine


def listening(pid):
    """(address, port) at which the process or a child of it listens; none of one that has ended."""
    found = set()
    try:
        process = psutil.Process(pid)
        for each in (process, *process.children(recursive=True)):
            found |= {tuple(c.laddr) for c in each.net_connections("inet") if c.status == psutil.CONN_LISTEN}
    except psutil.NoSuchProcess:
        pass
    return found


@contextmanager
def started(program, *arguments, cwd):
    process = subprocess.Popen(
        [sys.executable, str(program), *map(str, arguments)],
        cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def watched(process):
    """Everything at which it listened, until it ended."""
    found, end = set(), time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < end:
        found |= listening(process.pid)
        time.sleep(0.05)
    return found


def test_a_socket_for_others_would_be_seen():
    with socket.create_server(("0.0.0.0", 0)) as server:
        assert ("0.0.0.0", server.getsockname()[1]) in listening(os.getpid())


def test_the_3_d_view_of_pick_place(tmp_path):
    with started(ROOT / "diagrams" / "pick_place.py", cwd=tmp_path) as process:
        found = watched(process)
        assert process.returncode == 0, process.stderr.read()
    assert found
    assert {address for address, _ in found} <= LOOPBACK


def test_the_live_page(tmp_path):
    with Program(tmp_path) as program:
        found = listening(program.process.pid)
    assert {port for _, port in found} == {program.port, program.meshcat_port}
    assert {address for address, _ in found} <= LOOPBACK


def test_the_pool_of_this_machine_serves_nothing(tmp_path):
    weights = save_untrained(tmp_path)
    asked = ("--weights", weights, "--episodes", 4, "--disturbance", "none", "--workers", 2)
    with started(Path(__file__).with_name("sweep_fakes.py"), *asked, cwd=tmp_path) as process:
        assert watched(process) == set()
        assert process.returncode == 0, process.stderr.read()


def test_a_cluster_is_asked_without_serving_anything():
    from distributed import LocalCluster

    from diagrams.sweeps.cluster import DaskPool
    from tests.diagrams.sweeps.test_cluster import LOCAL

    with LocalCluster(processes=False, **LOCAL) as cluster:
        before = listening(os.getpid())
        with DaskPool(cluster.scheduler_address, {}):
            assert listening(os.getpid()) == before
