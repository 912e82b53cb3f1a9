"""The plots of the page, each of a source that the page feeds."""

from collections.abc import Callable

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, DataRange1d, Legend, LegendItem, Range1d, Span
from bokeh.palettes import Category10_7
from bokeh.plotting import figure

from diagrams.world.names import ARM_JOINTS
from systems.detector import GUARD

SHOWN_SECONDS = 20.0  # of the plots


def _plot(height: int, label: str, y_range, **options):
    follow = DataRange1d(follow="end", follow_interval=SHOWN_SECONDS, range_padding=0.0)
    made = figure(
        height=height, width=640, x_range=follow, y_range=y_range, y_axis_label=label, toolbar_location=None,
        output_backend="canvas", **options,
    )  # fmt: skip
    made.min_border_left = 65
    return made


def alpha_plot(live: ColumnDataSource):
    plot = _plot(130, "alpha", Range1d(-0.05, 1.05))
    plot.step("time", "active", source=live, color="orange", alpha=0.6, line_width=5, legend_label="held")
    plot.step("time", "alpha", source=live, color="crimson", line_width=2, legend_label="alpha", mode="after")
    plot.add_layout(Span(location=GUARD, dimension="width", line_dash="dashed", line_color="gray"))
    _small_legend(plot)
    return plot


def errors_plot(live: ColumnDataSource):
    plot = _plot(140, "errors / gamma", Range1d(1e-3, 1e5), y_axis_type="log")
    plot.line("time", "first", source=live, color="#8888dd", legend_label="of the prediction")
    plot.line("time", "worst", source=live, color="black", line_width=2, legend_label="the largest")
    plot.add_layout(Span(location=1.0, dimension="width", line_dash="dashed", line_color="crimson"))
    _small_legend(plot)
    return plot


def joints_plot(live: ColumnDataSource):
    plot, items = _plot(300, "joints (deg)", DataRange1d(range_padding=0.05)), []
    plot.xaxis.axis_label = "time in the scene (s)"
    for letter, when, dash, width in (
        ("m", "time", "solid", 2), ("i", "imagined_time", "dashed", 2), ("r", "recalled_time", "dotted", 3),
    ):  # fmt: skip
        lines = [
            plot.line(when, f"{letter}{j}", source=live, color=Category10_7[j - 1], line_dash=dash,
                      line_width=width)
            for j in range(1, ARM_JOINTS + 1)
        ]  # fmt: skip
        word = {"m": "measured", "i": "imagined", "r": "recalled, a second later"}[letter]
        items.append(LegendItem(label=word, renderers=lines, index=0))
    plot.add_layout(Legend(items=items, orientation="horizontal"), "above")
    _small_legend(plot)
    return plot


def picture_plot(source: ColumnDataSource, title: str):
    plot = figure(
        width=190, height=215, title=title, x_range=(0, 1), y_range=(0, 1), toolbar_location=None,
        x_axis_location=None, y_axis_location=None,
    )  # fmt: skip
    plot.grid.grid_line_color = None
    plot.image_rgba("image", x=0, y=0, dw=1, dh=1, source=source)
    return plot


def desk_map(desk: ColumnDataSource, lower: np.ndarray, upper: np.ndarray, put: Callable[[float, float], object]):
    """The desk from above, as from behind the arm: x up, y to the left, m; a click at (x, y) calls `put`."""
    plot = figure(
        width=240, height=215, title="the can: click to put it", toolbar_location=None, tools="tap",
        x_range=Range1d(upper[1] + 0.03, lower[1] - 0.03), y_range=Range1d(lower[0] - 0.03, upper[0] + 0.03),
        x_axis_label="y (m)", y_axis_label="x (m)", match_aspect=True, name="desk",
    )  # fmt: skip
    plot.quad(left=lower[1], right=upper[1], bottom=lower[0], top=upper[0], color="#dddddd")
    plot.scatter("y", "x", source=desk, size=14, color="crimson")
    plot.on_event(Tap, lambda event: put(event.y, event.x))
    return plot


def rgba(picture: np.ndarray) -> np.ndarray:
    """uint8 (h, w, 3) as Bokeh draws it: uint32 (h, w), the lowest row first."""
    image = np.full((*picture.shape[:2], 4), 255, np.uint8)
    image[:, :, :3] = picture[::-1]
    return image.view(np.uint32).reshape(picture.shape[:2])


def _small_legend(plot) -> None:
    plot.legend.label_text_font_size = "11px"
    plot.legend.padding = plot.legend.margin = 2
    plot.legend.background_fill_alpha = 0.6
    if plot.legend.location != "above":
        plot.legend.location = "top_left"
