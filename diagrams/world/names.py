"""Names and sizes that many rooms need, and nothing else: importing it costs nothing."""

import math

from models.command_line import ROOT
from models.errors import InputError
from systems.disturbance import KINDS

DISTURBANCES, MOVED = KINDS[:3], KINDS[3]  # none, A and B of Sec. IV-B of the paper; the can alone is moved
ARM_JOINTS = 7
FINGERS = ("left", "right")  # of the gripper
SPOTS = ("left", "right")  # on the shelf
CANS = ("can_to_pick", "can_on_shelf")  # models of a world
DIRECTIVES = ".dmd.yaml"  # end of the name of a file of model directives in sdf/
CAN_HALF_HEIGHT, CAN_RADIUS = 0.05, 0.0265  # m
LIMIT_MARGIN = math.radians(2.0)  # of a joint limit that no disturbance comes nearer to, rad
IN_HAND = 0.03  # m: a can nearer than that to the grasp frame is between the fingers
WEIGHTS = ROOT / "models" / "weights"  # the trained networks that ship
ENCODER, DECODER = "encoder.onnx", "decoder.onnx"  # files of the autoencoder's halves in such a folder


def other_spot(spot: str) -> str:
    """The spot of SPOTS that is not `spot`; raises InputError for one that is not there."""
    if spot not in SPOTS:
        raise InputError(f"there is no spot '{spot}' on the shelf: choose one of {', '.join(SPOTS)}")
    return SPOTS[1 - SPOTS.index(spot)]
