"""The one list of the recoveries."""

from models.registry import Registry

SHIPPED = "planned"  # what a controller does that is told nothing
RECOVERIES: Registry = Registry(
    "recovery",
    {
        "planned": "systems.recoveries.planned:PlannedRecovery",
        "backoff": "systems.recoveries.backoff:BackoffRecovery",
        "regulator": "systems.recoveries.regulator:RegulatorRecovery",
        "hold": "systems.recoveries.hold:HoldRecovery",
        "retrace": "systems.recoveries.retrace:RetraceRecovery",
    },
    needs=("build", "looks"),
)
