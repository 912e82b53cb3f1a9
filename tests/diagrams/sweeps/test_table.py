"""The table of a sweep: what is written is read, and what cannot be used is refused at once."""

from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from diagrams.sweeps.table import read_tables, write_table
from diagrams.sweeps.task import ROBUSTNESS
from models.errors import InputError
from tests.diagrams.sweep_fakes import make_task, outcome_row


def sweep(folder, gamma=None, **changes):
    folder.mkdir()
    rows = [outcome_row(folder, make_task(seed, "A", gamma=gamma)) | changes for seed in range(2)]
    write_table(folder, rows)
    return rows


def test_sweeps_are_read_together_and_no_episode_twice(tmp_path):
    own = sweep(tmp_path / "own")
    sweep(tmp_path / "swept", gamma=3.0, success=None, failure=None, paper_switch_success=None)
    rows = read_tables([tmp_path / "own", tmp_path / "swept"])
    assert rows["success"].tolist() == [row["success"] for row in own] + [None, None]
    assert rows["gamma"].isna().tolist() == [True, True, False, False]
    assert rows["gamma"].dtype == float
    assert rows["alpha_max_before"].tolist()[:2] == [row["alpha_max_before"] for row in own]
    with pytest.raises(InputError, match="they would count twice"):
        read_tables([tmp_path / "own", tmp_path / "own"])


def test_a_table_of_another_version_is_refused(tmp_path):
    sweep(tmp_path / "old")
    path = tmp_path / "old" / "episodes.parquet"
    pd.read_parquet(path).drop(columns=["paper_switch_success", "error_peak_normal"]).to_parquet(path)
    with pytest.raises(InputError, match=r"no column paper_switch_success, error_peak_normal, another version .*again"):
        read_tables([tmp_path / "old"])


def test_text_that_is_none_is_damage(tmp_path):
    sweep(tmp_path / "bent")
    path = tmp_path / "bent" / "episodes.parquet"
    table = pq.read_table(path)
    bent = pa.array([b"recal\xff"] * len(table), pa.binary()).view(pa.string())
    pq.write_table(table.set_column(table.column_names.index("detector"), "detector", bent), path)
    with pytest.raises(InputError, match=r"episodes.parquet is damaged"):
        read_tables([tmp_path / "bent"])


def test_no_table_or_a_damaged_one(tmp_path):
    with pytest.raises(InputError, match=r"nowhere/episodes.parquet does not exist: run diagrams/sweep.py"):
        read_tables([Path("nowhere")])
    (tmp_path / "episodes.parquet").write_bytes(b"PAR1 but no more")
    with pytest.raises(InputError, match=r"episodes.parquet is damaged"):
        read_tables([tmp_path])


def test_columns_that_came_later_are_empty_in_an_older_table(tmp_path):
    sweep(tmp_path / "old")
    path = tmp_path / "old" / "episodes.parquet"
    whole = pd.read_parquet(path)
    later = ["traceback", "severity", *(name for name in whole.columns if name.startswith(ROBUSTNESS))]
    whole.drop(columns=later).to_parquet(path)
    found = read_tables([tmp_path / "old"])
    assert len(later) == 11
    assert found[later].isna().all(axis=None)
    assert found["seed"].tolist() == whole["seed"].tolist()
