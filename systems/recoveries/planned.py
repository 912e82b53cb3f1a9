"""The way home that looks: the LQR's step, changed where it would come near to something."""


class PlannedRecovery:
    """What ships. The step is the LQR's; AccelerationLimit and the world's ClearanceFilter stand behind the mixer.

    It ends when alpha falls: at home the network starts anew, and what it recalls becomes an arm at rest there.
    """

    name = "planned"
    looks = True

    @staticmethod
    def build(policy, joints: int, period: float) -> None:
        """None: the LQR."""
