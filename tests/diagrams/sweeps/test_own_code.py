"""A fault or a detector of another package that was changed since: a sweep does not mix its rows with those of now."""

import sys

import pytest

from diagrams import sweep
from diagrams.episodes.pool import Pool
from diagrams.sweeps.plan import SweepArguments
from diagrams.sweeps.table import require_rows
from diagrams.sweeps.task import run_task
from models.errors import InputError
from tests.diagrams import sweep_fakes
from tests.diagrams.untrained import save_untrained

THEIRS = """
from systems.detectors import DETECTORS
from systems.faults.camera_blur import CameraBlur


class Fault(CameraBlur):
    name = "theirs"


class Detector(DETECTORS["recall"]):
    name = "theirs_too"
"""


@pytest.mark.parametrize("given", [{"disturbance": ["other_package:Fault"]}, {"detector": ["other_package:Detector"]}])
def test_a_changed_one_is_refused(tmp_path, monkeypatch, given):
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(sweep, "Pool", lambda workers: Pool(0))
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    monkeypatch.setattr("diagrams.episodes.calibration.stored_calibration", lambda *given: None)
    monkeypatch.setattr("diagrams.episodes.calibration.learned_hash", lambda *given: "learned")
    (tmp_path / "weights").mkdir()
    asked = SweepArguments(
        weights=save_untrained(tmp_path / "weights"),
        out=tmp_path / "out",
        **{"disturbance": ["A"], "episodes": 2} | given,
    )

    def start(text):
        monkeypatch.delitem(sys.modules, "other_package", raising=False)
        (tmp_path / "other_package.py").write_text(text)
        return sweep.main(asked)

    assert start(THEIRS) == 0
    assert start(THEIRS) == 0
    with pytest.raises(
        InputError, match=r"or of another version of your detector, fault or recovery: choose another --out"
    ):
        start(THEIRS + "# changed\n")


def test_a_worker_with_another_version_of_it_says_so(tmp_path):
    row = run_task(tmp_path, sweep_fakes.make_task(own_code="another"))
    assert "another version of your detector, fault or recovery" in row["error"]


def test_rows_of_before_it_was_noted_are_rows():
    row = sweep_fakes.outcome_row(None, sweep_fakes.make_task())
    del row["own_code"]
    require_rows("rows.jsonl", {"key": row})
