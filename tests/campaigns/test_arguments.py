"""What all campaigns have in common: numbers that are refused before any work, and a log."""

import importlib

import pytest

from models.errors import InputError


@pytest.mark.parametrize("name", ["cluster", "fuzz", "kills", "machine", "soak", "stl"])
def test_a_count_below_zero_is_refused_and_a_log_is_kept(name, tmp_path):
    campaign = importlib.import_module(f"tests.campaigns.{name}")
    assert campaign.parse([]).out.parts[0] == "outputs"
    with pytest.raises(InputError, match="--count -1 is too small: choose "):
        campaign.main(campaign.parse(["--count", "-1", "--out", str(tmp_path / "out")]))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["kills", "machine"])
def test_a_program_that_there_is_not_is_refused(name, capsys):
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"tests.campaigns.{name}").parse(["--targets", "none"])
    assert ended.value.code == 2
    assert "invalid choice" in " ".join(capsys.readouterr().err.split())
