"""Faults for tests: built for an arm of three joints, run tick by tick, evaluated once."""

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U

from diagrams.world.faults.registry import FAULTS
from systems.disturbance import DisturbanceParameters
from systems.faults.fault import Setting
from tests.systems.system_checks import as_bytes

J, PERIOD, SIZE = 3, 0.1, 56
HAND, ELBOW = (BodyIndex(4), np.array([0.0, 0.0, 0.1])), (BodyIndex(2), np.zeros(3))
SETTING = Setting(J + 1, J, PERIOD, SIZE, SIZE, {"hand": HAND, "elbow": ELBOW})
ONSET, HOLD = 3, 4  # ticks, in `run`


def picture(rgb) -> ImageRgba8U:
    """Of that colour, a number or (SIZE, SIZE, 3)."""
    made = ImageRgba8U(SIZE, SIZE)
    made.mutable_data[:, :, :3], made.mutable_data[:, :, 3] = rgb, 255
    return made


def ports(system, which: str) -> list:
    """Its input or output ports."""
    return [getattr(system, f"get_{which}_port")(i) for i in range(getattr(system, f"num_{which}_ports")())]


def context_of(system, severity: float, seed: int = 7, hold: int = HOLD):
    """A Context with these parameters."""
    context = system.CreateDefaultContext()
    target = (0.3 * np.arange(1, J * system.targets + 1)).tolist() or None
    given = DisturbanceParameters(hold_ticks=0 if system.lasts else hold, severity=severity, target=target)
    system.set_parameters(context, given, seed)
    return context


def evaluate(name: str, output: str, inputs: dict, severity: float, seed: int = 7, ticks: int = 0, hold: int = HOLD):
    """The output of the fault `name`, `ticks` after its onset; `inputs`: by port, pictures as arrays."""
    system = FAULTS[name](SETTING)
    context = context_of(system, severity, seed, hold)
    for port, value in (inputs | {"ticks_since_onset": [float(ticks)]}).items():
        system.GetInputPort(port).FixValue(context, picture(value) if port == "rgb_image" else value)
    return system.GetOutputPort(output).Eval(context)


def seen(name: str, rgb, severity: float, **when) -> np.ndarray:
    """(SIZE, SIZE, 3) uint8: what a fault of the camera makes of a picture."""
    return evaluate(name, "faulty_rgb_image", {"rgb_image": rgb}, severity, **when).data[:, :, :3].copy()


def inputs_of(system, rng: np.random.Generator) -> dict:
    """Random inputs, by name, but for the onset."""
    found = {}
    for port in ports(system, "input"):
        if port.get_name() == "rgb_image":
            found["rgb_image"] = picture(rng.integers(256, size=(SIZE, SIZE, 3)))
        elif port.get_name() != "ticks_since_onset":
            found[port.get_name()] = rng.uniform(size=port.size())
    return found


def run(system, severity: float, ticks: int, seed: int = 7, cloned_at: int | None = None) -> list[dict]:
    """Bits of every output, and of inputs under `faulty_` and their name, in the middle of each tick.

    The onset is at tick ONSET; at `cloned_at` a clone of the Context goes on in another Simulator.
    """
    simulator, rng, found = Simulator(system, context_of(system, severity, seed)), np.random.default_rng(1), []
    for k in range(ticks):
        if k == cloned_at:
            simulator = Simulator(system, simulator.get_context().Clone())
        context, given = simulator.get_mutable_context(), inputs_of(system, rng)
        # A tick's updates see what was before them, as those of Disturbance's neighbours do.
        for port, value in given.items():
            system.GetInputPort(port).FixValue(context, value)
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(max(k - 1 - ONSET, -1))])
        simulator.AdvanceTo((k + 0.25) * PERIOD)
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(max(k - ONSET, -1))])
        out = {port.get_name(): as_bytes(port.Eval(context)) for port in ports(system, "output")}
        found.append({f"in_{name}": as_bytes(value) for name, value in given.items()} | out)
    return found
