"""The can is moved far on the desk while the hand comes."""

from diagrams.world.faults.scene_fault import ShiftedCan


class CanMovedFar(ShiftedCan):
    """The can is moved far on the desk while the hand comes.

    .. pydrake_system::

        name: CanMovedFar
        input_ports: [ticks_since_onset]
        output_ports: [acting, can_pose]

    See PoseFault for the ports.
    """

    name = "can_moved_far"
    severity_1 = "by 10 to 14 cm, within the trained area"
    subtask = 1
    moved_by = (0.10, 0.14)
