import json
from pathlib import Path

import numpy as np
import pytest

from models.training.__main__ import main, parse
from models.training.probe import regress


def test_regression_finds_a_smooth_function_between_the_training_points() -> None:
    rng = np.random.default_rng(0)
    mix = rng.normal(size=(2, 30))

    def features(xy: np.ndarray) -> np.ndarray:
        return np.tanh(xy @ mix + 0.01 * rng.normal(size=(len(xy), 30)))

    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 7)), -1).reshape(-1, 2)
    test = rng.uniform(-0.9, 0.9, (30, 2))
    error = np.linalg.norm(regress(features(grid), grid, features(test), np.arange(49)) - test, axis=1)
    assert np.median(error) < 0.03


def test_program_reports_and_writes_json(
    tmp_path: Path, data_file: Path, encoder_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "probe.json"
    assert main(parse(["probe", "--data", str(data_file), "--encoder", str(encoder_file), "--json", str(out)])) == 0
    result = json.loads(out.read_text())
    assert f"median {result['median_mm']:.1f} mm" in capsys.readouterr().out
    assert 0 < result["median_mm"] <= result["p95_mm"] <= result["max_mm"]
    assert result["positions"] == 4
