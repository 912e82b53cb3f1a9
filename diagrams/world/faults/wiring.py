"""How a fault gets into a diagram: its ports are named after the signals that it reads and replaces."""

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS
from diagrams.world.faults.scene_fault import PoseFault, SceneFault
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation
from models.errors import InputError
from systems.faults.fault import Fault, Setting

REPLACES = "faulty_"  # begins the name of an output that takes the place of a signal
# Inputs of the station that a fault's output of the same name is connected to, each only with such a fault.
INTO_STATION = ("can_pose", "neighbour_pose")


class FaultInDiagram:
    """The system of one fault, wired between the parts of a Rollout.

    Attributes:
        kind: as it was asked for.
        fault: its system, which has the output `acting`.
        signals: every signal by its name, as it is behind the fault; and `spatial_force`, if it pulls at the plant.
    """

    def __init__(
        self, builder: DiagramBuilder, station: PickPlaceStation, kind: str, size: int, signals: dict[str, OutputPort]
    ):
        """Adds it to `builder`.

        Args:
            kind: see FAULTS.
            size: M, of the posture.
            signals: what a fault may read, by name: rgb_image, posture, desired_posture, finger_gap, alpha,
                ticks_since_onset, and joint_angles where the station has them; and replace: the first three and active.

        Raises InputError for a fault that reads or replaces something else.
        """
        world, plant = station.world, station.plant
        grasp, elbow = plant.GetFrameByName("grasp"), plant.GetBodyByName("link_4")
        bodies = {
            "hand": (grasp.body().index(), grasp.GetFixedPoseInBodyFrame().translation()),
            "elbow": (elbow.index(), np.zeros(3)),
        }
        setting = Setting(size, ARM_JOINTS, world.timing.period, world.camera.width, world.camera.height, bodies)
        self.kind, self._station = kind, station
        self.fault: Fault = builder.AddNamedSystem("fault", FAULTS[kind](setting))
        if station.HasOutputPort("joint_angles"):
            signals = signals | {"joint_angles": station.GetOutputPort("joint_angles")}
            builder.Connect(signals["desired_posture"], station.GetInputPort("told_posture"))
        self.signals = dict(signals)
        for port in map(self.fault.get_input_port, range(self.fault.num_input_ports())):
            if port.get_name() not in signals:
                words = f"reads '{port.get_name()}', which is no signal: choose from {', '.join(signals)}"
                raise InputError(f"the fault '{kind}' {words}")
            builder.Connect(signals[port.get_name()], port)
        for port in map(self.fault.get_output_port, range(self.fault.num_output_ports())):
            name = port.get_name()
            if name.startswith(REPLACES) and (replaced := name.removeprefix(REPLACES)) in signals:
                self.signals[replaced] = port
            elif name == "spatial_force":
                self.signals[name] = port
            elif name in INTO_STATION:
                builder.Connect(port, station.GetInputPort(name))
            elif name != "acting":
                raise InputError(f"the fault '{kind}' gives '{name}', which takes the place of nothing: see {__name__}")
        if self.fault.takes_arm:
            self.signals["active"] = self.fault.GetOutputPort("acting")

    @property
    def alters_posture(self) -> bool:
        """Whether the controller is told another posture than the true one."""
        return self.fault.HasOutputPort(f"{REPLACES}posture")

    def set(self, root: Context, given: DisturbanceSpec, seed: int, can: np.ndarray, neighbour: np.ndarray) -> None:
        """Puts what `given` says into the root's Context; nothing of a fault where it says that there is none.

        Args:
            seed: of everything that is random about it.
            can, neighbour: (3,) where the two cans stand, m, world.

        Raises InputError for another fault than the one that the diagram has.
        """
        own = self.fault.GetMyMutableContextFromRoot(root)
        if given.fault is None:
            self.fault.set_parameters(own, DisturbanceSpec(severity=0.0), seed)
            return
        if given.kind != self.kind:
            raise InputError(f"the diagram has the fault '{self.kind}', not '{given.kind}': build one with that")
        self.fault.set_parameters(own, given, seed)
        if isinstance(self.fault, SceneFault):
            self.fault.set_scene(root, self._station, given, (can, neighbour)[self.fault.moves])

    def neighbour(self, root: Context, stands: np.ndarray) -> np.ndarray:
        """(3,) where the other can, at `stands` in the beginning, shall stand in the end, m, world."""
        fault = self.fault
        if isinstance(fault, PoseFault) and fault.moves and fault.severity(fault.GetMyContextFromRoot(root)):
            return fault.pose(root)[4:]
        return stands
