"""The paper's way home: the LQR's, straight in the joint angles, whatever stands there."""


class RegulatorRecovery:
    """The step is the LQR's, grown evenly by AccelerationLimit, with no filter. It ends as that of PlannedRecovery."""

    name = "regulator"
    looks = False

    @staticmethod
    def build(policy, joints: int, period: float) -> None:
        """None: the LQR."""
