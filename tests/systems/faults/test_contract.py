"""What every fault promises: its ports, its words, when it acts, chance by its seed, all memory in the Context."""

import re
from pathlib import Path

import pytest
import yaml

import systems.faults
from diagrams.world.faults.registry import FAULTS
from models.errors import InputError
from systems.faults.fault import Fault
from tests.systems.faults.fault_cases import HOLD, ONSET, SETTING, context_of, ports, run

TICKS = 14
NAMES = list(FAULTS)
REPEATED = [name for name in NAMES if FAULTS[name].targets]
# Of these nothing is left to chance, or not in their systems.
CERTAIN = (
    "camera_blur", "camera_frozen", "camera_dropped", "camera_latency", "payload", "slack_gripper", "friction",
    "can_moved", "can_moved_far", "can_toppled", "neighbour_moved", *REPEATED,
)  # fmt: skip
every = pytest.mark.parametrize("name", NAMES)


def passes(tick: dict) -> bool:
    """Whether everything that has a faulty twin passes through."""
    pairs = [(out, tick[f"in_{name.removeprefix('faulty_')}"]) for name, out in tick.items() if "faulty_" in name]
    return all(out == given for out, given in pairs) and not tick.get("spatial_force")


@every
def test_ports_are_those_of_the_docstring(name):
    system = FAULTS[name](SETTING)
    block = re.search(r"pydrake_system::(.*?)\n\n(?!\s+name:)", type(system).__doc__, re.DOTALL).group(1)
    assert yaml.safe_load(block) == {
        "name": type(system).__name__,
        "input_ports": [port.get_name() for port in ports(system, "input")],
        "output_ports": [port.get_name() for port in ports(system, "output")],
    }


@every
def test_what_it_says_of_itself(name):
    fault = FAULTS[name]
    assert issubclass(fault, Fault)
    assert fault.name == name
    assert len(fault.severity_1) > 3
    assert len(fault.acts_on) > 3
    assert not (fault.lasts and fault.shortens)


@every
def test_nothing_passes_changed_before_the_onset_or_at_severity_0(name):
    system = FAULTS[name](SETTING)
    assert all(map(passes, run(system, 1.0, TICKS)[:ONSET]))
    assert all(map(passes, run(system, 0.0, TICKS)))


@every
def test_it_acts_as_long_as_it_should(name):
    system, fault = FAULTS[name](SETTING), FAULTS[name]
    acting = [bool(any(tick["acting"])) for tick in run(system, 1.0, TICKS)]
    if name in REPEATED:
        assert acting.index(True) == ONSET + 1  # its own first tick: it is told of the onset by then
        return
    last = TICKS if fault.lasts else ONSET + HOLD
    assert acting == [ONSET <= k < last for k in range(TICKS)]
    half = [bool(any(tick["acting"])) for tick in run(system, 0.5, TICKS)]
    assert sum(half) == (sum(acting) / 2 if fault.shortens else sum(acting))
    if not fault.lasts:
        assert all(map(passes, run(system, 1.0, TICKS)[last:]))


@every
def test_a_clone_of_the_context_goes_on_to_the_same_bits(name):
    system = FAULTS[name](SETTING)
    whole = run(system, 1.0, TICKS)
    for tick in (ONSET, ONSET + 2, ONSET + HOLD + 1):
        assert run(system, 1.0, TICKS, cloned_at=tick) == whole


@pytest.mark.parametrize("name", [name for name in NAMES if name not in CERTAIN])
def test_chance_is_the_seeds(name):
    system = FAULTS[name](SETTING)
    runs = [run(system, 1.0, TICKS, seed) for seed in (1, 1, 2, 3, 4, 5, 2**60)]
    assert runs[0] == runs[1]
    assert any(other != runs[0] for other in runs[2:])


@pytest.mark.parametrize("severity", [-0.1, 1.1, float("nan")])
def test_a_severity_that_is_none_is_refused(severity):
    with pytest.raises(ValueError, match=r"severity is .*from 0 to 1"):
        context_of(FAULTS["payload"](SETTING), severity)


def test_a_name_that_is_none_is_refused():
    with pytest.raises(InputError, match="there is no fault 'camera_gone': choose from camera_gain, camera_colour"):
        FAULTS["camera_gone"]


def test_the_list_of_the_package_is_that_of_its_files():
    listed = re.findall(r"^([a-z_]+) {2,}\S", systems.faults.__doc__, re.MULTILINE)
    assert sorted(listed) == sorted(path.stem for path in Path(systems.faults.__file__).parent.glob("[a-z]*.py"))
