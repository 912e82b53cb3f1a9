"""A slice of the campaign of a cluster's faults; and that it would tell a wrong answer from a right one."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from models.errors import InputError
from tests.campaigns import cluster
from tests.campaigns.cluster_case import Bad, Case, ClusterArguments
from tests.campaigns.network import Network

ROWS = {"a": {"success": True}, "b": {"success": False}}
TIMES = {"wall_seconds": 1.0, "realtime_factor": 2.0}


def test_a_worker_with_little_memory(tmp_path, monkeypatch):
    """A real scheduler, a real worker and a real sweep, which refuses."""
    monkeypatch.setattr(cluster, "WORKERS", 1)
    row = cluster.run_case(ClusterArguments(out=tmp_path), cluster.FAULTS.index(cluster.little_memory), {})
    assert row["well"], row["words"]
    assert "may use 0.50 GB of memory" in row["words"]


def test_cases_of_one_fault_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "here", lambda _: {})
    monkeypatch.setattr(cluster, "run_case", lambda _, number, __: {"fault": "x", "well": 1, "words": "", "seconds": 0})
    arguments = ClusterArguments(count=3, faults=["scheduler_restarted", "no_workers"], out=tmp_path)
    assert cluster.main(arguments) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["4", "12", "17", "3"]
    arguments.faults = ["rain"]
    with pytest.raises(InputError, match="there is no fault 'rain': choose from worker_killed"):
        cluster.main(arguments)


@pytest.fixture
def case(tmp_path):
    """Of a sweep that ended: write(lines, code, words) makes what it left."""

    def write(lines, code=0, words=""):
        network = SimpleNamespace(apart=False)
        made = Case(ClusterArguments(), tmp_path / "case", network, np.random.default_rng(0), ROWS, starts=1)
        made.rows.parent.mkdir(parents=True)
        entries = [{"fingerprint": {}}, *({"key": key, "row": row | TIMES} for key, row in lines)]
        made.rows.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
        (made.folder / "driver.log").write_text(words)
        return made, SimpleNamespace(poll=lambda: code, returncode=code)

    return write


def test_rows_as_on_this_machine_are_well(case):
    made, driver = case(ROWS.items())
    assert made.finish(driver).startswith("2 rows as on this machine")


@pytest.mark.parametrize(
    ("lines", "code", "said"),
    [
        ([("a", {"success": True}), ("b", {"success": True})], 0, "1 rows are not those of this machine: .'b'."),
        ([("a", {"success": True})], 0, "1 rows are not those of this machine"),
        ([*ROWS.items(), ("a", {"success": True})], 0, "3 rows were stored for 2 episodes"),
        (ROWS.items(), 1, "exit code 1 at start 1"),
    ],
)
def test_other_rows_and_rows_run_twice_are_not(case, lines, code, said):
    made, driver = case(lines, code)
    with pytest.raises(Bad, match=said):
        made.finish(driver)


def test_a_refusal_is_one_line_that_stores_nothing(case):
    made, driver = case([], 2, "error: no worker\n")
    assert made.refused(driver, "no worker") == "error: no worker"


@pytest.mark.parametrize(
    ("lines", "code", "words", "said"),
    [
        ([], 2, "error: a\nerror: b\n", "2 lines of error"),
        ([], 1, "error: a\n", "exit code 1"),
        ([], 2, "Traceback (most recent call last)\nerror: a\n", "Traceback"),
        ([], 2, "error: b\n", ".'a'. is not in: error: b"),
        ([("a", {})], 2, "error: a\n", "1 rows were stored"),
    ],
)
def test_other_refusals_are_not_well(case, lines, code, words, said):
    made, driver = case(lines, code, words)
    with pytest.raises(Bad, match=said):
        made.refused(driver, "a")


def test_hosts_reach_each_other_until_one_is_cut_off():
    reach = "import socket, sys; socket.create_connection((sys.argv[1], int(sys.argv[2])), 2.0)"
    with Network(1) as network:
        if not network.apart:
            pytest.skip("no network namespaces here: this takes Linux and root")
        serve = (
            f"import socket, time; s = socket.create_server(('{network.address(1)}', 5000)); print(); time.sleep(60)"
        )
        with subprocess.Popen([*network.on(1), sys.executable, "-uc", serve], stdout=subprocess.PIPE) as server:
            server.stdout.readline()
            command = [*network.on(0), sys.executable, "-c", reach, network.address(1), "5000"]
            assert subprocess.run(command, check=False, capture_output=True).returncode == 0
            network.cut(1)
            assert subprocess.run(command, check=False, capture_output=True).returncode == 1
            server.kill()
