"""The picture of the bench, from numbers made by hand: what stands where."""

import numpy as np

from diagrams.drawing import bench

FAMILIES = {"A": "arm and sensors", "payload": "arm and sensors", "camera_shift": "camera and scene"}


def cell(detector, fault, severity, noticed, tasks, recovery="planned"):
    judged = {"tpr": None, "tnr": {"value": 1.0 - noticed}} if fault == "none" else {"tpr": {"value": noticed}}
    return {
        "detector": detector, "fault": fault, "severity": severity, "recovery": recovery, "disturbed": judged,
        "tasks": None if tasks is None else {"value": tasks},
    }  # fmt: skip


def test_rows_by_family_and_columns_by_detector(tmp_path, monkeypatch):
    """Severities are rows of their own; what does not act has alarms alone; each recovery has its own tasks."""
    figures, save = [], bench.save
    monkeypatch.setattr(bench, "save", lambda figure, path: figures.append(figure) or save(figure, path))
    kinds = [("none", None), ("camera_shift", 1.0), ("A", None), ("payload", 0.5), ("payload", 1.0)]
    cells = [
        cell(name, *kind, noticed=share + 0.01 * i, tasks=done and done * scale, recovery=recovery)
        for i, kind in enumerate(kinds)
        for name, share, done in (("never", 0.0, 0.25), ("recall", 0.5, 0.75), ("speed", 0.9, None))
        for recovery, scale in (("planned", 1.0), ("hold", 0.4))
    ]
    bench.save_bench({"cells": cells}, FAMILIES, tmp_path / "bench.svg")
    left, right, second = figures[0].axes
    assert [label.get_text() for label in left.get_yticklabels()] == [
        "none", "A", "payload 0.5", "payload 1", "camera_shift 1",
    ]  # fmt: skip
    assert [label.get_text() for label in left.get_xticklabels()] == ["recall", "speed"]
    assert [label.get_text() for label in right.get_xticklabels()] == ["never", "recall"]
    shares = np.array(left.images[0].get_array())
    assert np.allclose(shares, np.add.outer([0.0, 0.02, 0.03, 0.04, 0.01], [0.5, 0.9]))
    assert np.allclose(np.array(right.images[0].get_array()), [[0.25, 0.75]] * 5)
    assert {text.get_text() for text in right.texts} == {"25", "75"}
    assert [label.get_text() for label in second.get_xticklabels()] == ["recall"]
    assert np.allclose(np.array(second.images[0].get_array()), 0.3)
    assert [axes.get_xlabel() for axes in (right, second)] == ["planned", "hold"]


def test_never_alone_is_drawn_too(tmp_path):
    bench.save_bench({"cells": [cell("never", "none", None, 0.0, 1.0)]}, {}, tmp_path / "bench.png")
    assert (tmp_path / "bench.png").stat().st_size > 1000
