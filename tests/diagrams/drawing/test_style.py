"""Figures that need no display and no backend."""

import os
import subprocess
import sys

import pytest
from matplotlib.image import imread

from diagrams.drawing.style import new_figure, save
from models.command_line import ROOT


@pytest.mark.parametrize("backend", ["module://no_package_of_this_name", "module://matplotlib_inline.backend_inline"])
def test_a_backend_from_outside_plays_no_part(tmp_path, backend):
    """A notebook sets one that is not installed here: pyplot, or any show, would fail."""
    code = (
        "import sys; from pathlib import Path; from diagrams.drawing.style import new_figure, save; "
        "figure, axis = new_figure(); axis.plot([0, 1]); save(figure, Path(sys.argv[1])); "
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    outside = {"MPLBACKEND": backend, "PYTHONPATH": str(ROOT)}
    subprocess.run(
        [sys.executable, "-c", code, tmp_path / "picture.png"], check=True, timeout=100, env=os.environ | outside
    )
    assert imread(tmp_path / "picture.png").ndim == 3


def test_size_and_axes_are_those_asked_for(tmp_path):
    figure, axes = new_figure(2, 3, figsize=(4, 2), sharex="col", height_ratios=(2, 1), squeeze=False)
    assert axes.shape == (2, 3)
    axes[0, 0].set_xlim(1, 7)
    assert axes[1, 2].get_xlim() != (1, 7)
    assert axes[1, 0].get_xlim() == (1, 7)
    save(figure, tmp_path / "new" / "picture.png")
    assert imread(tmp_path / "new" / "picture.png").shape[:2] == (220, 440)  # 110 dots per inch


@pytest.mark.parametrize(("name", "begins"), [("a.svg", b"<?xml"), ("a.pdf", b"%PDF")])
def test_formats(tmp_path, name, begins):
    figure, _ = new_figure()
    save(figure, tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(begins)
