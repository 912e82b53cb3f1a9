"""Eigenvalues at the switching point, and the decay of perturbations."""

from pathlib import Path

import numpy as np

from diagrams.drawing.style import BLUE, RED, new_figure, save


def save_spectra(cases: list[tuple[str, list[list[float]], list[np.ndarray]]], path: Path) -> None:
    """Eigenvalues beside the unit circle (left) and the norms of perturbations over the ticks (right), a row a case.

    `cases`: title, eigenvalues (real, imaginary), the largest first, and each perturbation's norms.
    """
    figure, axes = new_figure(len(cases), 2, figsize=(10, 3.8 * len(cases)), squeeze=False)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 400))
    for (title, eigenvalues, perturbations), (left, right) in zip(cases, axes, strict=True):
        values = np.array(eigenvalues)
        sizes = np.hypot(*values.T)
        left.plot(circle.real, circle.imag, color="0.6", lw=0.8)
        left.plot(*values.T, ".", color=BLUE, ms=4)
        left.plot(*values[sizes >= 1].T, "o", color=RED, mfc="none")
        left.set_aspect("equal", adjustable="datalim")
        left.set_title(f"{title}: spectral radius {sizes[0]:.4f}", fontsize=9)
        left.set(xlabel="real", ylabel="imaginary")
        for norms in perturbations:
            right.semilogy(norms, color=BLUE, lw=0.7, alpha=0.6)
        longest = max(perturbations, key=len)
        half = len(longest) // 2
        ticks = np.arange(half, len(longest))
        right.semilogy(ticks, longest[half] * sizes[0] ** (ticks - half), color=RED, ls="--", label="predicted")
        right.set(xlabel="ticks", ylabel="norm of the perturbation")
        right.legend(fontsize=8)
    save(figure, path)
