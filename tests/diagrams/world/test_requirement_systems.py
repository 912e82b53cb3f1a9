"""What the requirements look at, by hand: the signals, and the clearance on a way home."""

import re

import numpy as np
import pytest
import yaml
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from diagrams.episodes.way_home import WITHIN, WayHome
from diagrams.world.clearance_meter import ClearanceMeter
from diagrams.world.requirement_signals import RequirementSignals
from diagrams.world.requirements import SIGNALS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from tests.systems.system_checks import assert_clone_replays, fix

PERIOD = 0.1


@pytest.fixture(scope="module")
def systems(world, station):
    """RequirementSignals, ClearanceMeter."""
    return RequirementSignals(world, *controller_limits(station)), ClearanceMeter(world, station)


@pytest.mark.parametrize("which", [0, 1])
def test_ports_are_those_of_the_docstring(systems, which):
    system = systems[which]
    block = re.search(r"pydrake_system::(.*?)\n\n(?!\s+name:)", type(system).__doc__, re.DOTALL).group(1)
    assert yaml.safe_load(block) == {
        "name": type(system).__name__,
        "input_ports": [system.get_input_port(i).get_name() for i in range(system.num_input_ports())],
        "output_ports": [system.get_output_port(i).get_name() for i in range(system.num_output_ports())],
    }


def signals_of(system, alphas, **inputs):
    """The signals by name after the ticks with `alphas`."""
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix(system, context, {"alpha": [0.0]} | inputs)
    for k, alpha in enumerate(alphas):
        simulator.AdvanceTo(k * PERIOD + 0.01)
        system.GetInputPort("alpha").FixValue(context, [alpha])
    return dict(zip(SIGNALS, system.get_output_port().Eval(context), strict=True))


def test_signals_by_hand(systems, world, station):
    system, home = systems[0], world.initial_posture
    lower, upper, speed = controller_limits(station)
    command = home.copy()
    command[2] = upper[2] - 0.25
    inputs = {"active": [2.0], "clearance": [0.013], "posture": home, "desired_posture": command}
    found = signals_of(system, [0.0, 1.0, 0.3, 0.6], **inputs)
    assert (found["alpha"], found["active"], found["home"], found["crossings"]) == (0.6, 1.0, 1.0, 3.0)
    assert (found["clearance"], found["position_margin"]) == (0.013, pytest.approx(0.25))
    steps = np.abs(command - home)[:7] / PERIOD
    assert found["speed_margin"] == pytest.approx((speed[:7] - steps).min())
    command[3] = lower[3] - 0.1
    assert signals_of(system, [0.0], **inputs | {"desired_posture": command})["position_margin"] == pytest.approx(-0.1)


@pytest.mark.parametrize(("off", "home"), [(0.999, 1.0), (1.001, 0.0)])
def test_home_is_that_of_the_task(systems, world, off, home):
    posture = world.initial_posture.copy()
    posture[5] += off * HOME_TOLERANCE
    inputs = {"active": [0.0], "clearance": [0.05], "posture": posture, "desired_posture": posture}
    assert signals_of(systems[0], [0.0], **inputs)["home"] == home


def test_a_crossing_counts_for_a_second(systems, world):
    home = world.initial_posture
    inputs = {"active": [0.0], "clearance": [0.05], "posture": home, "desired_posture": home}
    counts = [signals_of(systems[0], [1.0, *[0.0] * n], **inputs)["crossings"] for n in (0, 1, 9, 10, 11)]
    assert counts == [1.0, 2.0, 2.0, 1.0, 0.0]


def test_a_clone_of_the_signals_goes_on_to_the_same_bits(systems, world):
    rng = np.random.default_rng(0)
    sizes = {"alpha": 1, "active": 1, "clearance": 1, "posture": 8, "desired_posture": 8}
    rows = [{name: rng.uniform(size=size) for name, size in sizes.items()} for _ in range(30)]
    assert_clone_replays(systems[0], rows, PERIOD)


@pytest.fixture(scope="module")
def metered(world):
    """A station whose clearance is measured: the diagram, the station, the meter."""
    builder = DiagramBuilder()
    station = builder.AddSystem(PickPlaceStation(world, camera=False))
    meter = builder.AddSystem(ClearanceMeter(world, station))
    builder.Connect(station.GetOutputPort("query_object"), meter.GetInputPort("query_object"))
    return builder.Build(), station, meter


@pytest.mark.parametrize(
    ("alpha", "active", "seen"), [(1.0, 0.0, True), (0.5, 0.0, True), (0.4, 0.0, False), (1.0, 1.0, False)]
)
def test_clearance_is_that_of_the_scoring_on_a_way_home_alone(metered, world, hand, alpha, active, seen):
    """The hand above the desk, nearer to it than what is told apart."""
    diagram, station, meter = metered
    root = diagram.CreateDefaultContext()
    station.set_scene(root, np.array([0.5, -0.05]), "left")
    joints = hand.solve_ik(np.array([0.56, 0.05, 0.04]))
    posture = np.append(joints, world.opening)
    station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(root), station.arm, joints)
    station.GetInputPort("desired_posture").FixValue(station.GetMyMutableContextFromRoot(root), posture)
    own = meter.GetMyMutableContextFromRoot(root)
    fix(meter, own, {"alpha": [alpha], "active": [active], "posture": posture})
    way = WayHome(station)
    way.see(root, closed=False)
    assert -WITHIN < way.nearest < WITHIN
    assert way.name is not None
    simulator = Simulator(diagram, root)
    simulator.AdvanceTo(0.01)  # the update of tick 0
    found = meter.get_output_port().Eval(meter.GetMyContextFromRoot(simulator.get_context()))[0]
    assert found == (way.nearest if seen else WITHIN)
