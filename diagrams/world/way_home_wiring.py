"""What stands between the controller's command and the arm on the way home, as the world asks for it."""

from dataclasses import replace

from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from diagrams.world.clearance_map import add_clearance_filter
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from systems.acceleration_limit import AccelerationLimit
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
    """Puts acceleration limit, incremental form and filter behind `command`; the port that the arm is to follow.

    Args:
        posture: (8,) as sampled at the tick.
        looks: whether the filter that `world.clearance` asks for is there.
        regulated: whether the steps are the LQR's: `world.regulator` is about no others.

    Raises InputError as `clearance_filter` does.
    """
    period = world.timing.period

    def behind(name: str, system: LeafSystem) -> OutputPort:
        """Puts `system` behind the command; its output."""
        builder.AddNamedSystem(name, system)
        for port, source in (("posture", posture), ("alpha", alpha), ("desired_posture", command)):
            builder.Connect(source, system.GetInputPort(port))
        return system.get_output_port()

    incremental = None
    if regulated:
        limit = AccelerationLimit(
            joints=ARM_JOINTS, initial_posture=world.initial_posture, acceleration=world.regulator.acceleration,
            period=period,
        )  # fmt: skip
        command = behind("acceleration_limit", limit)
    if regulated and world.regulator.offset > 0.0:
        lower, upper, speed = controller_limits(station)
        # Behind the limit, which would cut what is carried on from the last command.
        incremental = IncrementalCommand(
            posture_size=len(lower), joints=ARM_JOINTS, lower=lower, upper=upper,
            max_step=speed[:ARM_JOINTS] * period, largest_offset=world.regulator.offset, period=period,
        )  # fmt: skip
        command = behind("incremental_command", incremental)
    seen = world if looks else replace(world, clearance=replace(world.clearance, cans="unseen"))
    sent = add_clearance_filter(builder, seen, station, posture, alpha, command)
    if incremental is not None:
        builder.Connect(sent, incremental.GetInputPort("sent_posture"))
    return sent
