"""What the arm does while alpha is high: the step that takes the place of dm^L in Eq. 3, and what ends it.

A recovery is a class that `systems.recoveries.registry.RECOVERIES` finds by a name or as `package.module:Class`:

    name: str, a short one.
    looks: bool, whether the clearance filter of the world stands behind its steps.
    build(policy, joints, period) -> System | None: static; the system that gives the steps of the first `joints`
        components. None: the LQR does, and the law of systems/README.md stays as it is.
    backoff: float, where there is one: by what factor each return raises what the next alarm must reach
        (`systems.alarm_backoff`).

The system has the ports of `systems.recoveries.timed_recovery`.

===============  ===================================================================================================
registry         the one list of the recoveries
planned          what ships: the LQR's way home, changed where it would come near to something
backoff          the same, and after each return the next alarm asks for ten times the error
regulator        the paper's: the LQR's way home, straight
timed_recovery   what those share that do not lead home: so many ticks, then the network goes on (discrete state)
hold             stand still
retrace          back along the own last ticks, arm and network (discrete state)
===============  ===================================================================================================
"""
