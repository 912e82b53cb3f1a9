"""What stands between the controller's command and the arm on the way home, as the world asks for it."""

from dataclasses import replace

from pydrake.systems.framework import DiagramBuilder, OutputPort

from diagrams.world.clearance_map import add_clearance_filter
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from systems.incremental_command import IncrementalCommand


def add_way_home(
    builder: DiagramBuilder,
    world: World,
    station: PickPlaceStation,
    posture: OutputPort,
    alpha: OutputPort,
    command: OutputPort,
    looks: bool,
    regulated: bool,
) -> OutputPort:
    """Puts incremental form and filter behind `command`; the port that the arm is to follow.

    Args:
        posture: (8,) as sampled at the tick.
        looks: whether the filter that `world.clearance` asks for is there.
        regulated: whether the steps are the LQR's: `world.regulator.offset` is about no others.

    Raises InputError as `clearance_filter` does.
    """
    incremental = world.regulator.offset > 0.0 and regulated
    if incremental:
        lower, upper, speed = controller_limits(station)
        period = world.timing.period
        system = IncrementalCommand(
            posture_size=len(lower), joints=ARM_JOINTS, lower=lower, upper=upper,
            max_step=speed[:ARM_JOINTS] * period, largest_offset=world.regulator.offset, period=period,
        )  # fmt: skip
        builder.AddNamedSystem("incremental_command", system)
        for name, port in (("posture", posture), ("alpha", alpha), ("desired_posture", command)):
            builder.Connect(port, system.GetInputPort(name))
        command = system.get_output_port()
    seen = world if looks else replace(world, clearance=replace(world.clearance, cans="unseen"))
    sent = add_clearance_filter(builder, seen, station, posture, alpha, command)
    if incremental:
        builder.Connect(sent, system.GetInputPort("sent_posture"))
    return sent
