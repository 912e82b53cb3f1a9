"""The hybrid automaton of runs, and their modes over time."""

from pathlib import Path

from diagrams.drawing.style import BLUE, RED, new_figure, save

COLOURS = {"task": BLUE, "return": RED}


def save_automaton(report: dict, path: Path) -> None:
    """Draws the automaton with counts and dwell times (left) and every run's modes over time (right).

    `report`: of the analysis `modes`.
    """
    from matplotlib.patches import Circle

    figure, (left, right) = new_figure(1, 2, figsize=(13, 5.2), width_ratios=(1, 1.25))
    left.set(xlim=(-2.6, 2.6), ylim=(-1.75, 1.75), aspect="equal")
    left.axis("off")
    for x, mode, law in ((-1.5, "task", r"$\alpha<1/2$"), (1.5, "return", r"$\alpha\geq 1/2$")):
        colour, dwell = COLOURS[mode], report["dwell_seconds"][mode]
        left.add_patch(Circle((x, 0.0), 0.8, facecolor=colour, alpha=0.18, edgecolor=colour, lw=2))
        words = [rf"$\bf{{{mode}}}$", law]
        if dwell["count"]:
            words += [f"{dwell['min']:.1f} / {dwell['median']:.1f} / {dwell['max']:.1f} s", f"stays: {dwell['count']}"]
        left.text(x, 0.0, "\n".join(words), ha="center", va="center", fontsize=9)
    arrow = {"arrowstyle": "-|>", "lw": 1.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 16, "color": "0.2"}
    for x, y, transition, text in (
        (-0.95, 0.55, "task->return", "recall fails\nLQR alone; network imagines"),
        (0.95, -0.55, "return->task", "recalls again at home\nreset: input := measured"),
    ):
        left.annotate("", (-x, y), (x, y), arrowprops={**arrow, "connectionstyle": "arc3,rad=-0.35"})
        text = f"{report['transitions'][transition]} times: {text}"
        left.text(0, y + (0.62 if y > 0 else -0.62), text, ha="center", va="center", fontsize=8)
    left.annotate("", (-2.3, 0.0), (-2.6, 0.0), arrowprops=arrow)
    title = f"runs: {report['runs']}; dwell times: shortest / median / longest between two crossings"
    left.set_title(title, fontsize=9)
    runs = report["sequences"]
    for row, run in enumerate(runs):
        for stay in run["modes"]:
            right.barh(row, stay["end"] - stay["start"], left=stay["start"], color=COLOURS[stay["mode"]], lw=0)
    right.set(ylim=(len(runs) - 0.4, -0.6), xlabel="time (s)")
    step = max(1, len(runs) // 30)
    right.set_yticks(range(0, len(runs), step), [f"{r['name']} ({r['outcome']})" for r in runs[::step]], fontsize=6)
    title = f"modes over time; at most {report['max_crossings_per_second']} crossings in a second"
    right.set_title(title, fontsize=9)
    save(figure, path)
