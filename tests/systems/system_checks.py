"""Evaluate one output of one system; run a system twice from a cloned Context."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context


def fix(system, context: Context, inputs: dict) -> None:
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)


def evaluate(system, output: str, inputs: dict, calibration=None):
    """The output `output` with the given inputs; `calibration`: of a detector, reference errors, beta and gamma."""
    context = system.CreateDefaultContext()
    if calibration is not None:
        system.set_calibration(context, *calibration)
    fix(system, context, inputs)
    return system.GetOutputPort(output).Eval(context)


def evaluate_autodiff(system, output: str, inputs: dict, with_respect_to: str, context: Context | None = None):
    """The value of `output` and its gradient with respect to one input, by the system converted to AutoDiffXd.

    `context`: of the system in floats, whose parameters are taken.
    """
    system = system.ToAutoDiffXd()
    converted = system.CreateDefaultContext()
    if context is not None:
        converted.SetTimeStateAndParametersFrom(context)
    inputs = {name: np.array([AutoDiffXd(x) for x in np.atleast_1d(value)]) for name, value in inputs.items()}
    size = len(inputs[with_respect_to])
    seeds = zip(inputs[with_respect_to], np.eye(size), strict=True)
    inputs[with_respect_to] = np.array([AutoDiffXd(x.value(), unit) for x, unit in seeds])
    fix(system, converted, inputs)
    result = system.GetOutputPort(output).Eval(converted)
    gradients = [x.derivatives() if len(x.derivatives()) else np.zeros(size) for x in result]
    return np.array([x.value() for x in result]), np.array(gradients)


def outputs(system, context: Context) -> dict:
    """Every output by its name."""
    ports = map(system.get_output_port, range(system.num_output_ports()))
    return {port.get_name(): port.Eval(context) for port in ports}


def as_bytes(value) -> bytes:
    """A vector, a picture, or a list of forces on bodies."""
    if isinstance(value, list):
        return b"".join(force.F_Bq_W.get_coeffs().tobytes() for force in value)
    return np.asarray(getattr(value, "data", value)).tobytes()


def snapshot(system, context: Context) -> dict:
    """All outputs and the discrete state as bytes."""
    bits: dict = {name: as_bytes(value) for name, value in outputs(system, context).items()}
    for i in range(context.num_discrete_state_groups()):
        bits[i] = np.array(context.get_discrete_state(i).value()).tobytes()
    return bits


def run_from(system, context: Context, inputs: list[dict], period: float) -> list[dict]:
    """Advances a period for each set of inputs; returns a snapshot after each."""
    simulator = Simulator(system, context)
    context = simulator.get_mutable_context()
    snapshots = []
    for values in inputs:
        fix(system, context, values)
        simulator.AdvanceTo(context.get_time() + period)
        snapshots.append(snapshot(system, context))
    return snapshots


def assert_clone_replays(system, inputs: list[dict], period: float) -> None:
    """Runs half of the inputs, clones the Context, runs the rest from the clone and from the original: same bits."""
    half = len(inputs) // 2
    context = system.CreateDefaultContext()
    run_from(system, context, inputs[:half], period)
    clone = context.Clone()
    first = run_from(system, context, inputs[half:], period)
    assert first == run_from(system, clone, inputs[half:], period)
