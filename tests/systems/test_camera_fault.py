"""CameraFault: what the controller sees of a picture, and that a frozen one is that of its own tick."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U

from systems.camera_fault import BRIGHTNESS, CLEAR, COVERED, DARKENED, FROZEN, CameraFault


def picture(value):
    made = ImageRgba8U(4, 4)
    made.mutable_data[:] = value
    return made


def run(faults):
    """At tick k the picture is all 100 + k, the fault `faults[k]`; what comes out at each tick, and between them."""
    system = CameraFault(4, 4, 0.1)
    simulator = Simulator(system)
    context, found = simulator.get_mutable_context(), []
    for k, fault in enumerate(faults):
        system.GetInputPort("rgb_image").FixValue(context, picture(100 + k))
        system.GetInputPort("fault").FixValue(context, [fault])
        at_the_tick = system.get_output_port().Eval(context).data[0, 0, :3].tolist()
        simulator.AdvanceTo((k + 0.5) * 0.1)
        between = system.get_output_port().Eval(context).data
        assert at_the_tick == between[0, 0, :3].tolist()
        assert np.all(between[:, :, 3] == 255)
        simulator.AdvanceTo((k + 0.99) * 0.1)
        found.append(at_the_tick[0])
    return found


def test_frozen_again_and_again():
    assert run([CLEAR, FROZEN, FROZEN, CLEAR, FROZEN, FROZEN, CLEAR]) == [100, 101, 101, 103, 104, 104, 106]


@pytest.mark.parametrize(("fault", "seen"), [(COVERED, 0), (DARKENED, int(BRIGHTNESS * 101))])
def test_covered_and_darkened(fault, seen):
    assert run([CLEAR, fault, CLEAR]) == [100, seen, 102]
