"""The constraints file of the lowest versions says what pyproject.toml says; versions.sh says what it did not run."""

import os
import re
import subprocess
import tomllib

import pytest

from models.command_line import ROOT

CAMPAIGNS = ROOT / "tests" / "campaigns"


def lowest_of_project():
    """Package to its lower bound, of the dependencies and every extra; each bounded above too."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *(r for extra in project["optional-dependencies"].values() for r in extra)]
    found = dict[str, str]()
    for requirement in asked:
        if requirement.startswith("hindsight["):
            continue
        name, bounds = re.fullmatch(r"([\w-]+)(?:\[[\w,]+\])?([^;]*)(?:;.*)?", requirement).groups()
        low, *others = bounds.strip().split(",")
        assert low.startswith("==") or any(bound.startswith("<") for bound in others), requirement
        assert re.fullmatch(r"(>=|==)[\d.]+\*?", low), requirement
        assert found.setdefault(name, low[2:]) == low[2:], f"two lower bounds of {name}"
    return found


def test_the_lowest_versions_are_those_of_the_project():
    lines = [line for line in (CAMPAIGNS / "lowest.txt").read_text().splitlines() if not line.startswith("#")]
    assert dict(line.split("==") for line in lines) == lowest_of_project()
    assert len(lines) == len(lowest_of_project()) > 30


@pytest.mark.parametrize(("bits", "code", "words"), [("true", 3, "lowest: passed"), ("false", 1, "lowest: FAILED")])
def test_figures_beyond_their_tolerance_are_no_pass(tmp_path, bits, code, words):
    """Of environments that are there, made up, in which the suite passes."""
    made_up = {"python3.11": "true", "lowest/bin/pip": "true"}
    made_up["lowest/bin/python"] = f"case $1 in *same_bits.py) {bits};; esac"
    for name, script in made_up.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    given = {"DIR": str(tmp_path), "PYTHON311": str(tmp_path / "python3.11"), "PYTHON313": "/nowhere/python"}
    done = subprocess.run(
        [str(CAMPAIGNS / "versions.sh")],
        env=os.environ | given,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == code, done.stderr
    assert done.stdout.startswith(words)


def test_a_python_that_is_not_there_is_not_called_passed(tmp_path):
    (tmp_path / "bash").symlink_to("/bin/bash")  # and no Python
    done = subprocess.run(
        ["/bin/bash", str(CAMPAIGNS / "versions.sh")],
        env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["lowest", "newest", "0 of 2 passed"]
    assert "not found" in done.stdout
    assert os.access(CAMPAIGNS / "versions.sh", os.X_OK)
