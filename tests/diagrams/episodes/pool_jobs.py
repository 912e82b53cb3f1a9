"""Jobs for the pool's tests: functions that a worker process can import."""

import os
import signal
import struct
import sys
import time
from pathlib import Path

from diagrams.episodes.pool import kept_in_thread


def double(job):
    return 2 * job


def fail_at_three(job):
    if job == 3:
        raise ValueError("three")
    return job


def kill_own_worker(job):
    """A job (folder, name): the first time it is run its worker dies."""
    folder, name = job
    mark = Path(folder) / name
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return name


def kill_every_worker(job):
    if job == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def wait_or_die(job):
    if job == "deadly":
        time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def process_and_count(job):
    """The process, and how many jobs it has had before this one with the same key."""
    counter = kept_in_thread(("counter", job), list)
    counter.append(None)
    return os.getpid(), len(counter) - 1


def write_pid_and_sleep(path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(60)


def slow_after_two(job):
    if job >= 2:
        time.sleep(200)
    return job


def die_while_answering(job):
    """A worker that is killed in the middle of its answer: the pipe holds the beginning of a message."""
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000) + b"begun")
    os.kill(os.getpid(), signal.SIGKILL)
