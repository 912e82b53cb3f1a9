"""The can is moved on the desk while the hand comes."""

from diagrams.world.faults.scene_fault import ShiftedCan


class CanMoved(ShiftedCan):
    """The can is moved on the desk while the hand comes.
    At severity 1 it is the disturbance `moved`, to the bit.

    .. pydrake_system::

        name: CanMoved
        input_ports: [ticks_since_onset]
        output_ports: [acting, can_pose]

    See PoseFault for the ports.
    """

    name = "can_moved"
    severity_1 = "by 3 to 6 cm, within the trained area"
    subtask = 1
    moved_by = (0.03, 0.06)
