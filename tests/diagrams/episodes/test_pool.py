"""The pool: results as they come, workers that die, a parent that dies."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from diagrams.episodes.pool import ATTEMPTS, Pool, WorkerDied, kept_in_thread
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.episodes import pool_jobs


@pytest.fixture(scope="module")
def pool():
    with Pool(2) as pool:
        yield pool


def test_each_job_comes_with_its_result(pool):
    assert sorted(pool.run(pool_jobs.double, range(7))) == [(n, 2 * n) for n in range(7)]


def test_no_worker_means_this_thread():
    with Pool(0) as pool:
        found = list(pool.run(pool_jobs.process_and_count, ["a", "a"]))
    assert found == [("a", (os.getpid(), 0)), ("a", (os.getpid(), 1))]


def test_an_error_of_a_job_is_raised_and_ends_the_rest(pool):
    seen = []
    with pytest.raises(ValueError, match="three"):
        seen += [job for job, _ in pool.run(pool_jobs.fail_at_three, range(50))]
    assert sorted(pool.run(pool_jobs.double, [1])) == [(1, 2)]  # the pool is usable


def test_a_worker_that_dies_while_it_is_idle_is_replaced():
    with Pool(1) as own:
        [(_, (pid, _))] = own.run(pool_jobs.process_and_count, ["a"])
        os.kill(pid, signal.SIGKILL)
        time.sleep(0.5)  # until the executor knows
        [(_, (other, _))] = own.run(pool_jobs.process_and_count, ["a"])
    assert other != pid


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts open files by Linux's /proc")
def test_a_worker_that_died_under_an_abandoned_job_is_replaced():
    with Pool(2) as own:
        run = own.run(pool_jobs.wait_or_die, ["quick", "deadly"])
        assert next(run) == ("quick", "quick")
        run.close()  # the other one dies meanwhile
        assert sorted(own.run(pool_jobs.double, range(4))) == [(n, 2 * n) for n in range(4)]


def test_workers_are_made_when_there_is_a_job_for_them():
    before = len(os.listdir("/proc/self/fd"))
    with Pool(1000) as many:
        assert list(many.run(pool_jobs.double, [3])) == [(3, 6)]
        assert len(os.listdir("/proc/self/fd")) < before + 50


def test_jobs_are_handed_out_one_by_one(pool):
    taken = []
    run = pool.run(pool_jobs.double, (taken.append(n) or n for n in range(4)))
    assert next(run)[1] in (0, 2)
    run.close()
    assert sorted(pool.run(pool_jobs.double, [5])) == [(5, 10)]


def test_a_worker_makes_way_after_so_many_jobs(monkeypatch):
    monkeypatch.setattr("diagrams.episodes.pool.JOBS_A_WORKER", 3)
    with Pool(1) as pool:
        found = [result for _, result in pool.run(pool_jobs.process_and_count, "aaaaaaa")]
    assert [count for _, count in found] == [0, 1, 2, 0, 1, 2, 0]
    assert len({pid for pid, _ in found}) == 3


def test_a_dead_worker_is_replaced_and_its_job_run_again(pool, tmp_path):
    jobs = [(str(tmp_path), name) for name in "abc"]
    assert sorted(name for _, name in pool.run(pool_jobs.kill_own_worker, jobs)) == ["a", "b", "c"]


def test_a_worker_that_is_killed_in_the_middle_of_its_answer_is_not_waited_for():
    command = "from diagrams.episodes.pool import Pool; from tests.diagrams.episodes import pool_jobs as jobs\n"
    command += "if __name__ == '__main__':\n with Pool(1) as pool: print(list(pool.run(jobs.die_while_answering, [1], "
    command += "lambda job, gone: str(gone))))"
    ended = subprocess.run(
        [sys.executable, "-c", command], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert f"{ATTEMPTS} workers died" in ended.stdout


def test_a_job_that_kills_its_workers_is_given_up(pool):
    jobs = ["one", "deadly", "two"]
    found = dict(pool.run(pool_jobs.kill_every_worker, jobs, lambda job, gone: str(gone)))
    assert (found["one"], found["two"]) == ("one", "two")
    assert found["deadly"].startswith(f"{ATTEMPTS} workers died")
    with pytest.raises(WorkerDied) as refused:  # one line and exit code 2, no traceback
        list(pool.run(pool_jobs.kill_every_worker, ["deadly"]))
    assert isinstance(refused.value, InputError)
    assert "give each worker 1 GB of memory or more" in refused.value.__notes__[0]


def test_what_is_kept_is_made_once_and_the_oldest_goes():
    made = []

    def make(name):
        return kept_in_thread(("things", name), lambda: made.append(name) or name, most=2)

    assert [make(name) for name in "aabbca"] == ["a", "a", "b", "b", "c", "a"]
    assert made == ["a", "b", "c", "a"]


def test_workers_end_with_a_killed_parent(tmp_path):
    code = (
        "from diagrams.episodes.pool import Pool\nfrom tests.diagrams.episodes import pool_jobs\n"
        f"if __name__ == '__main__':\n    list(Pool(2).run(pool_jobs.write_pid_and_sleep, [{str(tmp_path / 'a')!r}, "
        f"{str(tmp_path / 'b')!r}]))"
    )
    script = tmp_path / "parent.py"
    script.write_text(code)
    surroundings = os.environ | {"PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(script)], env=surroundings, start_new_session=True)
    files = [tmp_path / "a", tmp_path / "b"]
    _wait_for(lambda: all(f.exists() and f.read_text() for f in files))
    workers = [int(f.read_text()) for f in files]
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    _wait_for(lambda: not any(_alive(pid) for pid in workers))


def _alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def _wait_for(condition, seconds=40.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("workers", [-1, 1001])
def test_a_number_of_workers_out_of_range_is_refused(workers):
    with pytest.raises(InputError, match=f"workers {workers} is out of range: choose from 0 to 1000"):
        Pool(workers)
