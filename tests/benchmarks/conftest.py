"""Ratios of times within one run, on a machine on which nothing else runs: pytest tests/benchmarks --measure.

Without --measure each runs in short, as a test, and its ratio means nothing. One thread, as everywhere at batch 1.
"""

import numpy as np
import pytest
import torch

from diagrams.world.configuration import World

ROUNDS = 5
FOUND = pytest.StashKey[list[str]]()


def pytest_addoption(parser):
    parser.addoption("--measure", action="store_true", help="measure the benchmarks' ratios and hold them to limits")


@pytest.fixture(scope="session")
def measure(request):
    return request.config.getoption("--measure", default=False)


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def world():
    return World()


@pytest.fixture(scope="session")
def in_turns(measure):
    """Called with functions that return times: the median over rounds of each one's ratio to the last one's."""

    def run(*functions):
        for function in functions:
            function()  # what is first in a process
        times = np.array([[function() for function in functions] for _ in range(ROUNDS if measure else 1)])
        return np.median(times / times[:, -1:], axis=0)[:-1]

    return run


@pytest.fixture
def hold(request, measure):
    """Called with a ratio and its limit: kept for the table at the end, and asserted."""

    def check(what, ratio, at_most=None, at_least=None):
        limit = f"at most {at_most}" if at_least is None else f"at least {at_least}"
        request.config.stash.setdefault(FOUND, []).append(f"{what:58s}{ratio:8.3f}   {limit}")
        if measure:
            assert at_most is None or ratio <= at_most, f"{what}: {ratio:.3f}, {limit}"
            assert at_least is None or ratio >= at_least, f"{what}: {ratio:.3f}, {limit}"

    return check


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("--measure", default=False):
        terminalreporter.write_line("\n".join(config.stash.get(FOUND, [])))
