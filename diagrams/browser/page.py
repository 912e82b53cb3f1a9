"""The page: what is drawn of a Session, and its widgets. One Bokeh document a browser, all of one session."""

import html
import time
from collections.abc import Callable

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.model import Model
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    Div,
    InlineStyleSheet,
    RadioButtonGroup,
    Select,
    Slider,
    TextInput,
)

from diagrams.browser.plots import alpha_plot, desk_map, errors_plot, joints_plot, picture_plot, rgba
from diagrams.browser.run import Run
from diagrams.browser.session import KEPT_ROWS
from diagrams.world.hands_schedule import LARGEST_FORCE
from diagrams.world.names import ARM_JOINTS
from models.errors import InputError
from models.networks import NETWORKS
from systems.camera_fault import FAULTS
from systems.detectors import DETECTORS

UPDATE_MS = 50  # between two looks at the session
SPEEDS = {"a quarter": 0.25, "half": 0.5, "real time": 1.0, "2 times": 2.0, "5 times": 5.0, "the fastest": 0.0}
COLUMNS = (
    "time", "imagined_time", "recalled_time", "alpha", "worst", "first", "active", "wall",
    *(f"{letter}{j}" for letter in "mir" for j in range(1, ARM_JOINTS + 1)),
)  # fmt: skip
LIVE, HAND = "live", "hand"  # names of the source of the plots, and of the one that says what a person's hand does

# The button, wherever in the page, and the space bar: down and up, each for itself. Whatever takes the page away lets
# the arm go; so does a click into the 3-D view, which gives the keys back once the pointer leaves it.
HOLDING = """
const down = {key: 0, pointer: 0}
const hold = (change) => {
  Object.assign(down, change)
  const held = down.key | down.pointer
  if (hand.data.hold[0] !== held) hand.data = {hold: [held]}
}
const nothing = {key: 0, pointer: 0}
const focused = () => {
  let found = document.activeElement
  while (found && found.shadowRoot && found.shadowRoot.activeElement) found = found.shadowRoot.activeElement
  return found
}
const typing = (event) => event.composedPath().some((n) => n.tagName === 'INPUT' || n.tagName === 'SELECT')
const on_button = (event) => event.composedPath().some((n) => n.classList && n.classList.contains('hold-the-arm'))
document.addEventListener('pointerdown', (event) => { if (on_button(event)) hold({pointer: 1}) })
for (const name of ['pointerup', 'pointercancel']) document.addEventListener(name, () => hold({pointer: 0}))
for (const [name, key] of [['keydown', 1], ['keyup', 0]]) document.addEventListener(name, (event) => {
  if (event.code !== 'Space' || typing(event)) return
  event.preventDefault()
  hold({key})
}, true)
document.addEventListener('pointermove', (event) => {
  const frame = focused()
  if (frame && frame.tagName === 'IFRAME' && !event.composedPath().includes(frame)) {
    frame.blur()
    window.focus()
  }
})
window.addEventListener('blur', () => hold(nothing))
document.addEventListener('visibilitychange', () => hold(nothing))
"""
# A browser is sent nothing new before it has drawn the last: a slow one sees fewer updates, not old ones.
NEVER = -1_000_000  # tick of a picture that was not drawn yet
DRAWN = "requestAnimationFrame(() => setTimeout(() => { drawn.data = {update: [sent.data.update[0]]} }))"
STYLE = ":host { font-size: 13px; } .bk-btn { font-size: 13px; }"


class Page:
    """The document of one browser."""

    def __init__(self, document: Document, run: Run, scene_url: str):
        """`scene_url`: of Meshcat."""
        self._document, self._run, self._name = document, run, document.session_context.id
        self._seen, self._pictured = (0, 0), NEVER
        self._newest: float | None = None  # when the last tick of what is being drawn was run
        self._live = ColumnDataSource({name: [] for name in COLUMNS}, name=LIVE)
        self._hand = ColumnDataSource({"hold": [0]}, name=HAND)
        self._sent, self._drawn = (ColumnDataSource({"update": [0]}, name=name) for name in ("sent", "drawn"))
        self._images = [ColumnDataSource({"image": []}) for _ in range(2)]
        self._desk = ColumnDataSource({"x": [], "y": []})
        self._message = Div(text="", name="message", styles={"color": "#c53030", "min-height": "1.3em"})
        self._status = Div(text="", name="status", width=470, styles={"font-size": "15px"})
        self._events = Div(text="", name="events", width=470, height=120)
        document.title = "Hindsight, live"
        document.add_root(self._layout(scene_url))
        self._hand.on_change("data", lambda _a, _o, new: self._say(lambda: self._hold(bool(new["hold"][0]))))
        document.js_on_event("document_ready", CustomJS(args={"hand": self._hand}, code=HOLDING))
        drawn = CustomJS(args={"sent": self._sent, "drawn": self._drawn}, code=DRAWN)
        self._sent.js_on_change("data", drawn)
        document.js_on_event("document_ready", drawn)  # what came with the page itself
        for source in (self._hand, self._sent, self._drawn):  # else no model of the document has them
            document.add_root(source)
        self._drawn.on_change("data", lambda _a, _o, _n: self._was_drawn())
        document.on_session_destroyed(lambda _: run.session.leave(self._name))
        document.add_periodic_callback(self._update, UPDATE_MS)

    def _hold(self, held: bool) -> None:
        self._run.session.hold(self._name, held)

    def _say(self, act: Callable[[], object]) -> None:
        """Does what a person asks for; what cannot be done is said in the page."""
        try:
            act()
            self._message.text = ""
        except InputError as error:
            self._message.text = html.escape(str(error))
        self._follow()

    # What is drawn.

    def _layout(self, scene_url: str):
        scene = Div(
            text=f'<iframe src="{html.escape(scene_url)}" title="the scene" '
            'style="width: 100%; height: 100%; border: 0"></iframe>',
            sizing_mode="stretch_width", height=460,
            stylesheets=[InlineStyleSheet(css=".bk-clearfix { width: 100%; height: 100%; }")],
        )  # fmt: skip
        desk = desk_map(self._desk, *self._run.session.bounds(), self._put_can)
        titles = "camera", self._run.session.second_title
        self._views = [picture_plot(*each) for each in zip(self._images, titles, strict=True)]
        left = column(scene, self._message, self._controls(), sizing_mode="stretch_width", min_width=640)
        right = column(
            self._status,
            *(plot(self._live) for plot in (alpha_plot, errors_plot, joints_plot)),
            row(*self._views, desk),
        )
        return row(left, right, sizing_mode="stretch_width")

    # What can be done.

    def _put_can(self, x: float, y: float) -> None:
        self._say(lambda: self._run.session.put_can(x, y))

    def _controls(self):
        run, session = self._run, self._run.session
        lower, upper = session.bounds()

        def button(label: str, act: Callable[[], object], name: str | None = None, kind: str = "default") -> Button:
            made = Button(label=label, button_type=kind, name=name, stylesheets=[InlineStyleSheet(css=STYLE)])
            made.on_click(lambda: self._say(act))
            return made

        hold = Button(
            label="Hold the arm (or the space bar)", button_type="danger", css_classes=["hold-the-arm"], width=240
        )
        move = button("Move it to a random posture (A)", lambda: run.session.move(), "move", "warning")
        self._forces = [
            Slider(title=f"pull {axis} (N)", start=-LARGEST_FORCE, end=LARGEST_FORCE, step=1, width=150,
                   value=session.force[i], name=f"pull_{axis}")
            for i, axis in enumerate("xyz")
        ]  # fmt: skip
        for i, slider in enumerate(self._forces):
            slider.on_change("value", lambda _a, _o, new, i=i: self._pull(i, new))
        place = [
            Slider(title=f"can {axis} (m)", start=lower[i], end=upper[i], step=0.005, format="0.000", width=150,
                   value=0.5 * (lower[i] + upper[i]))
            for i, axis in enumerate("xy")
        ]  # fmt: skip
        put = button("Put the can there", lambda: run.session.put_can(*(slider.value for slider in place)), "put")
        self._camera = RadioButtonGroup(
            labels=[f"camera {kind}" for kind in FAULTS], active=FAULTS.index(session.camera), name="camera"
        )
        self._camera.on_change("active", lambda _a, _o, new: self._set_camera(FAULTS[new]))
        self._pause = button("Pause", lambda: run.pause(not run.paused), "pause", "primary")
        self._speeds = dict(SPEEDS)
        self._chosen = {
            "seed": TextInput(title="seed", width=90, name="seed"),
            "rnn": Select(title="network", options=list(NETWORKS), width=100, name="rnn"),
            "detector": Select(title="detector", options=list(DETECTORS), width=100, name="detector"),
            "gamma": TextInput(title="gamma", width=90, name="gamma"),
            "speed": Select(title="speed", options=list(SPEEDS), width=110, name="speed"),
        }
        self._follow()
        for name, act in {
            "seed": lambda text: run.choose(seed=_number("seed", text, int)),
            "rnn": lambda text: run.choose(rnn=text),
            "detector": lambda text: run.choose(detector=text),
            "gamma": lambda text: run.session.set_gamma(_number("gamma", text, float)),
            "speed": lambda text: run.set_speed(self._speeds[text]),
        }.items():
            self._chosen[name].on_change("value", lambda _a, _o, new, name=name, act=act: self._choose(name, new, act))
        return column(
            row(hold, move),
            row(*self._forces, button("Let go", lambda: run.session.pull(np.zeros(3)), "let_go")),
            row(*place, put),
            self._camera,
            row(self._pause, button("One tick", run.single, "single"), button("Next scene", run.next_scene, "next"),
                button("Save", run.save, "save"), self._chosen["speed"]),
            row(*(self._chosen[name] for name in ("seed", "rnn", "detector", "gamma"))),
            self._events,
        )  # fmt: skip

    def _running(self) -> dict[str, str]:
        """What runs, as the fields of these names show it."""
        scenario, speed = self._run.session.scenario, self._run.pace.speed
        word = next((word for word, value in SPEEDS.items() if value == speed), f"{speed:g} times")
        self._speeds |= {word: speed}
        return {
            "seed": str(scenario.seed), "rnn": scenario.rnn, "detector": scenario.detector,
            "gamma": f"{self._run.session.gamma:.4g}", "speed": word,
        }  # fmt: skip

    def _follow(self) -> None:
        """What runs, in the widgets, where another page, the next scene or a refusal has left them behind."""
        for name, value in self._running().items():
            if isinstance(self._chosen[name], Select) and value not in self._chosen[name].options:
                self._chosen[name].options = [*self._chosen[name].options, value]
            self._put(self._chosen[name], value, "value")
        for slider, force in zip(self._forces, self._run.session.force, strict=True):
            self._put(slider, float(force), "value")
        self._put(self._camera, FAULTS.index(self._run.session.camera), "active")

    # Widgets also change where `_follow` changes them: what is already so is no wish.

    def _choose(self, name: str, text: str, act: Callable[[str], object]) -> None:
        if text != self._running()[name]:
            self._say(lambda: act(text))

    def _pull(self, axis: int, newtons: float) -> None:
        force = self._run.session.force
        if force[axis] != newtons:
            force[axis] = newtons
            self._say(lambda: self._run.session.pull(force, self._name))

    def _set_camera(self, kind: str) -> None:
        if kind != self._run.session.camera:
            self._say(lambda: self._run.session.fault(kind))

    def _was_drawn(self) -> None:
        if self._newest is not None:
            self._run.delays.add(time.time() - self._newest)

    # What is new.

    def _update(self) -> None:
        if not self._document.session_context.session.connection_count:  # not there yet, or gone
            self._run.session.leave(self._name)
            return
        self._follow()
        if self._drawn.data["update"][0] != self._sent.data["update"][0]:
            return
        session, run = self._run.session, self._run
        before = self._seen, self._pictured
        if self._seen[0] != session.scene:
            self._seen, self._pictured = (session.scene, 0), NEVER
            self._live.data = {name: [] for name in COLUMNS}
        new = session.ticks - self._seen[1]
        if new:
            rows = list(session.rows)[-new:]
            # Only so many of them can have been kept: in between, the page was away.
            self._live.stream({name: [each[name] for each in rows] for name in COLUMNS}, rollover=KEPT_ROWS)
            self._seen = session.scene, session.ticks
        # A picture takes as long as ten plots.
        if session.ticks and not session.diverged and session.ticks - self._pictured >= run.ticks_a_picture:
            self._pictured = session.ticks
            for source, picture in zip(self._images, session.pictures(), strict=True):
                source.data = {"image": [rgba(picture)]}
            self._put(self._views[1].title, session.second_title)
            x, y = session.can_xy()
            self._desk.data = {"x": [x], "y": [y]}
        if (self._seen, self._pictured) != before:
            self._newest = None if run.paused or not session.rows else session.rows[-1]["wall"]
            self._sent.data = {"update": [self._sent.data["update"][0] + 1]}
        self._put(self._status, run.words())
        events = "<br>".join(html.escape(f"{seconds:6.1f} s  {what}") for seconds, what in reversed(session.events))
        self._put(self._events, events)
        self._put(self._pause, "Go on" if run.paused else "Pause", "label")

    @staticmethod
    def _put(model: Model, value: object, attribute: str = "text") -> None:
        """Nothing is sent where nothing changed."""
        if getattr(model, attribute) != value:
            setattr(model, attribute, value)


def _number(name: str, text: str, kind: type[int] | type[float]) -> float:
    """`text` as a number of that kind; raises InputError for what is none."""
    try:
        return kind(text)
    except ValueError as error:
        word = "whole number" if kind is int else "number"
        raise InputError(f"{name} '{text}' is no {word}: type one") from error
