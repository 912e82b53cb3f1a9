"""The other can is moved on the shelf."""

from diagrams.world.faults.scene_fault import ShiftedCan


class NeighbourMoved(ShiftedCan):
    """The other can is moved on the shelf, away from the vacant spot or along it.

    .. pydrake_system::

        name: NeighbourMoved
        input_ports: [ticks_since_onset]
        output_ports: [acting, neighbour_pose]

    See PoseFault for the ports.
    """

    name = "neighbour_moved"
    severity_1 = "by 2.5 to 3.5 cm, not nearer to the vacant spot"
    acts_on = "the other can"
    moved_by = (0.025, 0.035)
    moves = 1
    needs = ("neighbour_pose",)
