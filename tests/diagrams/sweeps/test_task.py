"""A worker's part: an episode in, a row out, whatever happens in it."""

import pytest

from diagrams.sweeps import task as task_module
from diagrams.sweeps.task import error_row, run_task
from models.files.container import file_hash
from tests.diagrams.sweep_fakes import make_task
from tests.diagrams.untrained import save_untrained


def test_whatever_an_episode_raises_is_its_row(tmp_path, monkeypatch):
    row = run_task(tmp_path, make_task())
    assert row["error"].startswith("WeightsError: ")
    assert "Traceback" in row["traceback"]
    assert "in run_task" in row["traceback"]

    def leave(job):
        raise SystemExit("the plant has sampled output ports")

    monkeypatch.setattr(task_module, "run_episode", leave)
    row = run_task(tmp_path, make_task(7, "A"))
    assert row["error"] == "SystemExit: the plant has sampled output ports"
    assert (row["seed"], row["disturbance"], row["success"], row["switch_failure"]) == (7, "A", False, "error")


def test_a_worker_of_another_version_says_so(tmp_path):
    row = run_task(tmp_path, make_task(code="0123abcd"))
    assert "another version of the program" in row["error"]
    assert task_module.code_hash() in row["error"]
    assert "the sweep 0123abcd" in row["error"]


def test_weights_that_change_under_the_sweep_are_noticed(tmp_path):
    save_untrained(tmp_path)
    row = run_task(tmp_path, make_task(weights_hash="what it was", until="switching"))
    assert "lstm.onnx was changed under the sweep" in row["error"]
    good = run_task(tmp_path, make_task(weights_hash=file_hash(tmp_path / "lstm.onnx"), until="switching"))
    assert (good["error"], good["switch_failure"]) == (None, "false switch")


def test_an_error_row_keeps_where_it_was_raised():
    try:
        raise ValueError("two\nlines")
    except ValueError as error:
        row = error_row(make_task(3), error)
    assert row["error"] == "ValueError: two lines"
    assert "in test_an_error_row_keeps_where_it_was_raised" in row["traceback"]
    assert error_row(make_task(3), ValueError("never raised"))["traceback"] == "ValueError: never raised\n"


@pytest.mark.parametrize("detector", ["recall", "knn"])
def test_keys_tell_all_episodes_apart(detector):
    tasks = [
        make_task(s, d, gamma=g, rnn=r, until=u, detector=detector)
        for s in (0, 1)
        for d in "AB"
        for g in (None, 3.0, 3.5)
        for r in ("lstm", "gru")
        for u in ("task", "switching")
    ]
    keys = {task.key for task in tasks}
    assert len(keys) == len(tasks)
    assert all(f"-{detector}-" in key for key in keys)
