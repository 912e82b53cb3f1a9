"""The way home that looks, and after each one more patience."""


class BackoffRecovery:
    """As PlannedRecovery; but each return makes the next alarm ask for ten times the error: see AlarmBackoff.

    So a fault that stays, which a return does not mend, leaves the arm to the network in the end.
    """

    name = "backoff"
    looks = True
    backoff = 10.0

    @staticmethod
    def build(policy, joints: int, period: float) -> None:
        """None: the LQR."""
