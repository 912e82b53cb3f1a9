from pathlib import Path

import numpy as np
import pytest

from models.training import probe
from models.training.probe import main, regress


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
    assert main(["--data", str(data_file), "--encoder", str(encoder_file), "--json", str(out)]) == 0
    assert "mm" in capsys.readouterr().out
    result = probe.json.loads(out.read_text())
    assert 0 < result["median_mm"] <= result["p95_mm"] <= result["max_mm"]
    assert result["positions"] == 4


def test_missing_encoder_is_exit_code_2(data_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--data", str(data_file), "--encoder", "none.safetensors"]) == 2
    assert "none.safetensors: the weight file does not exist" in capsys.readouterr().err


def test_json_that_cannot_be_written_is_exit_code_2(
    tmp_path: Path, data_file: Path, encoder_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--data", str(data_file), "--encoder", str(encoder_file), "--json", str(tmp_path)]) == 2
    assert "Is a directory" in capsys.readouterr().err
