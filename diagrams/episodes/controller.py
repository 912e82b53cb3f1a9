"""The controller of a world: its limits, and what happens at home."""

from pydrake.systems.framework import System

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from models.errors import InputError
from systems.recoveries.registry import RECOVERIES, SHIPPED
from systems.switched_controller import SwitchedController


def make_controller(
    world: World, station: PickPlaceStation, encoder, policy, detector: System, recovery: str = SHIPPED
) -> SwitchedController:
    """See SwitchedController; `recovery`: of RECOVERIES. Raises InputError for parts that do not fit together."""
    chosen = RECOVERIES[recovery]
    backoff = getattr(chosen, "backoff", None)
    if backoff is not None and not (isinstance(backoff, int | float) and 1.0 < backoff <= 1e6):
        raise InputError(
            f"the recovery '{chosen.name}' has the backoff {backoff!r:.60}: give it a number above 1, at most 1e6"
        )
    if backoff is not None and detector.HasInputPort("gamma"):
        raise InputError(f"a person's hands may set gamma, which the recovery '{chosen.name}' raises: leave one out")
    lower, upper, speed = controller_limits(station)
    try:
        return SwitchedController(
            encoder,
            policy,
            detector,
            joints=ARM_JOINTS,
            regulator_Q=world.regulator.state_weight,
            regulator_R=world.regulator.input_weight,
            joint_lower=lower,
            joint_upper=upper,
            speed_limits=speed[:ARM_JOINTS],
            finger_openings=(world.closed_opening, world.opening),
            finger_thresholds=(world.close_below, world.open_above),
            period=world.timing.period,
            image_width=world.camera.width,
            image_height=world.camera.height,
            home_tolerance=HOME_TOLERANCE if world.resumption == "reset" else None,
            empty_below=world.empty_below if world.releases else None,
            recovery=chosen.build(policy, ARM_JOINTS, world.timing.period),
            backoff=backoff,
        )
    except ValueError as error:
        raise InputError(f"the controller cannot be built: {error}") from error
