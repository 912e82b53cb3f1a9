"""The detector of BENCH.md, as the page has it, in the bench."""

import functools
import json
import re
from dataclasses import replace

import pandas as pd
import pytest

from diagrams import bench
from diagrams.episodes.rollout import Rollout
from diagrams.monitors import bench_task
from diagrams.monitors.bench_plan import BenchArguments
from diagrams.monitors.tapes import taped_and_recorded
from models.command_line import ROOT
from tests.diagrams.untrained import save_untrained

SPEC = "mypackage.mymodule:MyDetector"


def test_the_page_brings_its_own(tmp_path, monkeypatch):
    page = (ROOT / "diagrams" / "BENCH.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert len(block.splitlines()) < 60
    assert SPEC in page
    (tmp_path / "mypackage").mkdir()
    (tmp_path / "mypackage" / "mymodule.py").write_text(block)
    (tmp_path / "weights").mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=1.0))

    def taped(job):  # of untrained networks, which do no task: that they did it is made up
        run, record = taped_and_recorded(job)
        return replace(run, outcome=replace(run.outcome, success=job.kind == "none")), record

    monkeypatch.setattr(bench_task, "taped_and_recorded", taped)
    given = BenchArguments(
        detectors=["recall", SPEC], faults=["friction"], fit_runs=2, calibration_runs=1, workers=0,
        weights=save_untrained(tmp_path / "weights"), out=tmp_path / "out",
    )  # fmt: skip
    assert bench.main(given) == 0
    table = pd.read_parquet(tmp_path / "out" / "bench.parquet")
    assert set(table["detector"]) == {"never", "oracle", "recall", "my_detector"}
    assert len(table[table["detector"] == "my_detector"]) == 2
    lines = (tmp_path / "out" / "rows.jsonl").read_text().splitlines()[1:]
    rows = [entry["row"] for entry in map(json.loads, lines) if entry["key"].startswith("off")]
    peaks = [row["detectors"]["my_detector"]["peaks"] for row in rows]
    assert all(tick[-1][1] > 0.0 for tick in peaks)
    with pytest.raises(SystemExit):  # the command line takes it
        bench.parse(["--detectors", "recall", SPEC, "--help"])
