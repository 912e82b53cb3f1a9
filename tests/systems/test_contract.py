"""What every system promises: the ports in its docstring, its feedthrough, and all of its memory in the Context."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.multibody.tree import BodyIndex

import systems
from models.networks.perceptron import random_layers, to_arrays
from systems.acceleration_limit import AccelerationLimit
from systems.alarm_backoff import AlarmBackoff
from systems.alpha_mixer import AlphaMixer
from systems.body_force import BodyForce
from systems.camera_fault import CameraFault
from systems.clusters_detector import ClustersDetector
from systems.cusum_detector import CusumDetector
from systems.dialled_detector import DialledDetector, GammaDial
from systems.distillation_detector import DistillationDetector
from systems.disturbance import Disturbance
from systems.ensemble_detector import EnsembleDetector
from systems.finger_release import FingerRelease
from systems.first_given import FirstGiven
from systems.flow_detector import FlowDetector
from systems.home_reset import HomeReset
from systems.image_encoder import ImageEncoder
from systems.incremental_command import IncrementalCommand
from systems.innovation_detector import InnovationDetector
from systems.knn_detector import KnnDetector
from systems.loop_closer import LoopCloser
from systems.mahalanobis_detector import MahalanobisDetector
from systems.manual_disturbance import ManualDisturbance
from systems.never_detector import NeverDetector
from systems.oracle_detector import OracleDetector
from systems.posture_history import PostureHistory
from systems.pyod_detector import PyodDetector
from systems.recall_detector import RecallDetector
from systems.recoveries.hold import HoldRecovery
from systems.recoveries.retrace import RetraceRecovery
from systems.recurrent_policy import RecurrentPolicy
from systems.regulated_mixer import RegulatedMixer
from systems.requirement_monitor import RequirementMonitor
from systems.reversals_detector import ReversalsDetector
from systems.signal_logic_text import parse_requirements
from systems.signal_schedule import SignalSchedule
from systems.speed_detector import SpeedDetector
from systems.subspace_detector import SubspaceDetector
from tests.systems.clearance_fakes import ToldWall, make_filter
from tests.systems.controller_fakes import PERIOD, FakeEncoder, FakePolicy, image, make_controller
from tests.systems.system_checks import assert_clone_replays

M, F, N = 4, 4, 2
POLICY_PORTS = ("predicted_posture", "predicted_features", "recalled_postures", "hidden_state")
CLOSER_INPUTS = ("posture", "features", "predicted_posture", "predicted_features", "alpha")
MIXER_INPUTS = ("posture", "predicted_posture", "regulator_step", "alpha")


LIMITS = dict(posture_size=M, joints=3, lower=-np.ones(M), upper=np.ones(M), max_step=np.ones(3))
LIMITS |= dict(finger_openings=(-0.5, 0.5), finger_thresholds=(-0.1, 0.1))
WINDOW_FEEDTHROUGH = {("posture_history", o) for o in ("errors", "alpha")}
DETECTOR_FEEDTHROUGH = {(i, o) for i in ("posture_history", "recalled_postures") for o in ("errors", "alpha")}
INNOVATION_FEEDTHROUGH = DETECTOR_FEEDTHROUGH | {
    (i, o) for i in ("features", "predicted_features") for o in ("errors", "alpha")
}
STATE = 12  # of FakePolicy, and 4 features
SEEN_FEEDTHROUGH = {(i, o) for i in ("hidden_state", "features") for o in ("errors", "alpha")}
REQUIRED = """
require first: always (a < 1 since[1:3 tick] (b > 0 and historically[2:inf tick] (a > 0 - 2)))
require second: eventually once[1:4 tick] (a < 0 since[2:inf tick] b < 0)
"""


def perceptron(name, *sizes):
    return to_arrays(name, random_layers(sizes, np.random.default_rng(0)))


def standard():
    return {"mean": np.zeros(STATE + F), "spread": np.ones(STATE + F)}


def pyod():
    from pyod.models.ecod import ECOD

    return PyodDetector(FakePolicy(), ECOD(), np.random.default_rng(0).normal(size=(50, STATE + F)))


CASES = {
    "ImageEncoder": (lambda: ImageEncoder(FakeEncoder()), {("rgb_image", "features")}),
    "RecurrentPolicy": (lambda: RecurrentPolicy(FakePolicy(), PERIOD), set()),
    "PostureHistory": (
        lambda: PostureHistory(posture_size=M, horizon=N, period=PERIOD, initial_posture=np.zeros(M)),
        {("posture", "posture_history")},
    ),
    "LoopCloser": (
        lambda: LoopCloser(posture_size=M, feature_size=F),
        {(i, "network_input") for i in CLOSER_INPUTS},
    ),
    "RecallDetector": (lambda: RecallDetector.build(FakePolicy(), 3, {}), DETECTOR_FEEDTHROUGH),
    "KnnDetector": (lambda: KnnDetector(FakePolicy(), np.zeros((3, 5, 2))), WINDOW_FEEDTHROUGH),
    "SubspaceDetector": (
        lambda: SubspaceDetector(FakePolicy(), np.tile(np.eye(3)[:, :2], (3, 1, 1))),
        WINDOW_FEEDTHROUGH,
    ),
    "NeverDetector": (lambda: NeverDetector(FakePolicy()), set()),
    "OracleDetector": (lambda: OracleDetector(FakePolicy(), 3), {("active", o) for o in ("errors", "alpha")}),
    "InnovationDetector": (lambda: InnovationDetector.build(FakePolicy(), 3, {}), INNOVATION_FEEDTHROUGH),
    "CusumDetector": (lambda: CusumDetector(FakePolicy(), 3, [1.0, 1.0]), INNOVATION_FEEDTHROUGH),
    "SpeedDetector": (lambda: SpeedDetector(FakePolicy(), 3), WINDOW_FEEDTHROUGH),
    "ReversalsDetector": (lambda: ReversalsDetector(FakePolicy(), 3), WINDOW_FEEDTHROUGH),
    "MahalanobisDetector": (
        lambda: MahalanobisDetector(FakePolicy(), np.zeros(STATE), np.eye(STATE)),
        {("hidden_state", o) for o in ("errors", "alpha")},
    ),
    "ClustersDetector": (
        lambda: ClustersDetector(FakePolicy(), np.zeros(STATE + F), np.eye(STATE + F)[:3], np.eye(3)),
        SEEN_FEEDTHROUGH,
    ),
    "DistillationDetector": (
        lambda: DistillationDetector(
            FakePolicy(), standard() | perceptron("target", 16, 5, 2) | perceptron("predictor", 16, 6, 2)
        ),
        SEEN_FEEDTHROUGH,
    ),
    "FlowDetector": (
        lambda: FlowDetector(FakePolicy(), standard() | perceptron("field", 17, 8, 16)),
        SEEN_FEEDTHROUGH,
    ),
    "PyodDetector": (pyod, SEEN_FEEDTHROUGH),
    "EnsembleDetector": (
        lambda: EnsembleDetector(FakePolicy(), 3, [FakePolicy(drift=0.02), FakePolicy(drift=0.03)]),
        {(i, o) for i in ("recalled_postures", "predicted_features") for o in ("errors", "alpha")},
    ),
    "AlphaMixer": (
        lambda: AlphaMixer(**LIMITS),
        {(i, "desired_posture") for i in MIXER_INPUTS} | {(i, "rnn_step") for i in MIXER_INPUTS[:3]},
    ),
    "RegulatedMixer": (
        lambda: RegulatedMixer(**LIMITS, initial_posture=np.zeros(M), Q=1.0, R=90.0, period=PERIOD),
        {(i, "desired_posture") for i in ("posture", "predicted_posture", "alpha")}
        | {("posture", "rnn_step"), ("predicted_posture", "rnn_step"), ("posture", "regulator_step")},
    ),
    "HomeReset": (
        lambda: HomeReset(posture_size=M, initial_posture=np.zeros(3), tolerance=np.ones(3)),
        {("posture", "reset"), ("alpha", "reset")},
    ),
    "AlarmBackoff": (
        lambda: AlarmBackoff(criteria=2, factor=10.0, period=PERIOD),
        {(i, o) for i in ("alpha", "errors") for o in ("answered_alpha", "given_up")},
    ),
    "HoldRecovery": (lambda: HoldRecovery(FakePolicy(), 3, PERIOD), {("alarm", "acting")}),
    "RetraceRecovery": (
        lambda: RetraceRecovery(FakePolicy(), 3, PERIOD),
        {("alarm", "acting"), ("alarm", "memory")},
    ),
    "FingerRelease": (
        lambda: FingerRelease(posture_size=M, joints=3, opening=[0.08], empty_below=[0.035]),
        {(i, "released_posture") for i in ("desired_posture", "reset", "finger_gaps")},
    ),
    "Disturbance": (
        lambda: Disturbance(posture_size=M),
        {("desired_posture", "disturbed_posture")},
    ),
    "SignalSchedule": (lambda: SignalSchedule(initial=[0.0, 1.0], period=PERIOD), set()),
    "ManualDisturbance": (
        lambda: ManualDisturbance(posture_size=M, joints=3, period=PERIOD),
        {("desired_posture", "disturbed_posture")},
    ),
    "BodyForce": (lambda: BodyForce(BodyIndex(1), np.zeros(3)), {("force", "spatial_force")}),
    "CameraFault": (lambda: CameraFault(112, 112, PERIOD), {(i, "faulty_image") for i in ("rgb_image", "fault")}),
    "FirstGiven": (lambda: FirstGiven(2), {("first", "given"), ("second", "given")}),
    "GammaDial": (lambda: GammaDial(3), {(i, "dialled_alpha") for i in ("errors", "alpha", "gamma")}),
    "DialledDetector": (
        lambda: DialledDetector(RecallDetector.build(FakePolicy(), 3, {})),
        DETECTOR_FEEDTHROUGH | {("gamma", "alpha")},
    ),
    "ClearanceFilter": (
        lambda: make_filter(ToldWall()),
        {
            (i, o)
            for i in ("posture", "desired_posture", "alpha", "obstacles")
            for o in ("filtered_posture", "clearance")
        },
    ),
    "AccelerationLimit": (
        lambda: AccelerationLimit(joints=3, initial_posture=np.zeros(M), acceleration=14.0, period=PERIOD),
        {(i, "limited_posture") for i in ("posture", "desired_posture", "alpha")},
    ),
    "IncrementalCommand": (
        lambda: IncrementalCommand(
            posture_size=M,
            joints=3,
            lower=-np.ones(M),
            upper=np.ones(M),
            max_step=np.ones(3),
            largest_offset=0.1,
            period=PERIOD,
        ),
        {(i, "incremental_posture") for i in ("posture", "desired_posture", "alpha")},
    ),
    "RequirementMonitor": (
        lambda: RequirementMonitor(parse_requirements(REQUIRED, ("a", "b"), PERIOD, "here"), ("a", "b"), PERIOD),
        {("signals", "robustness")},
    ),
    "SwitchedController": (
        make_controller,
        {(i, "network_input") for i in ("rgb_image", "posture")} | {("rgb_image", "features")},
    ),
}


def each(test):
    return pytest.mark.parametrize("name", CASES)(test)


def input_ports(system):
    return [system.get_input_port(i) for i in range(system.num_input_ports())]


def output_ports(system):
    return [system.get_output_port(i) for i in range(system.num_output_ports())]


@each
def test_ports_are_those_of_the_docstring(name):
    system = CASES[name][0]()
    block = re.search(r"pydrake_system::(.*?)\n\n(?!\s+name:)", type(system).__doc__, re.DOTALL).group(1)
    found = {
        "name": name,
        "input_ports": [port.get_name() for port in input_ports(system)],
        "output_ports": [port.get_name() for port in output_ports(system)],
    }
    assert yaml.safe_load(block) == {key: value for key, value in found.items() if value}


@each
def test_feedthrough(name):
    build, expected = CASES[name]
    system = build()
    found = {
        (input_port.get_name(), output_port.get_name())
        for input_port in input_ports(system)
        for output_port in output_ports(system)
        if system.HasDirectFeedthrough(input_port.get_index(), output_port.get_index())
    }
    assert found == expected


def random_inputs(system, rng):
    return {
        port.get_name(): image(rng.integers(255)) if port.get_name() == "rgb_image" else rng.normal(size=port.size())
        for port in input_ports(system)
    }


@each
def test_clone_of_the_context_replays_to_the_same_bits(name):
    system = CASES[name][0]()
    rng = np.random.default_rng(1)
    assert_clone_replays(system, [random_inputs(system, rng) for _ in range(12)], PERIOD)


def wires_of(controller):
    return {
        f"{source.get_name()}.{source.get_output_port(out).get_name()} -> "
        f"{target.get_name()}.{target.get_input_port(into).get_name()}"
        for (target, into), (source, out) in controller.connection_map().items()
    }


def test_topology_of_the_controller():
    assert wires_of(make_controller()) >= {
        "loop_closer.network_input -> recurrent_policy.network_input",
        "recurrent_policy.recalled_postures -> detector.recalled_postures",
        "recurrent_policy.hidden_state -> detector.hidden_state",
        "recurrent_policy.predicted_posture -> regulated_mixer.predicted_posture",
        "recurrent_policy.predicted_posture -> loop_closer.predicted_posture",
        "recurrent_policy.predicted_features -> loop_closer.predicted_features",
        "posture_history.posture -> regulated_mixer.posture",
        "posture_history.posture_history -> detector.posture_history",
        "image_encoder.features -> loop_closer.features",
        "detector.alpha -> loop_closer.alpha",  # this tick's, before the network steps
        "detector.alpha -> alpha_hold.u",
        "alpha_hold.y -> regulated_mixer.alpha",  # the same, held
        "detector.errors -> errors_hold.u",
        "posture_scaling.y0 -> loop_closer.posture",  # not the sampled one: the update needs this tick's
        "posture_scaling.y0 -> posture_history.posture",
    }


def test_what_the_reset_adds_to_the_controller():
    assert wires_of(make_controller(home_tolerance=0.1)) - wires_of(make_controller()) == {
        "detector.alpha -> home_reset.alpha",  # this tick's, before the network steps
        "posture_scaling.y0 -> home_reset.posture",
        "home_reset.reset -> recurrent_policy.reset",
    }


def test_what_further_inputs_of_a_detector_add_to_the_controller():
    policy = FakePolicy()
    told = {"predicted_features": "recurrent_policy", "network_input": "loop_closer", "features": "image_encoder",
            "reset": "home_reset"}  # fmt: skip
    plain = wires_of(make_controller(home_tolerance=0.1))
    for detector, names in (
        (InnovationDetector.build(policy, 3, {}), ("features", "predicted_features")),
        (CusumDetector(policy, 3, [1.0, 1.0]), ("features", "predicted_features", "reset")),
        (EnsembleDetector(policy, 3, [FakePolicy()]), ("predicted_features", "network_input", "reset")),
    ):
        wires = wires_of(make_controller(policy=policy, detector=detector, home_tolerance=0.1))
        assert wires - plain == {f"{told[name]}.{name} -> detector.{name}" for name in names}
    oracle = make_controller(policy=policy, detector=OracleDetector(policy, 3))
    assert (oracle.HasInputPort("active"), make_controller().HasInputPort("active")) == (True, False)


def test_what_the_release_of_empty_fingers_adds_to_the_controller():
    resetting = make_controller(home_tolerance=0.1)
    assert wires_of(make_controller(home_tolerance=0.1, empty_below=-0.5)) - wires_of(resetting) == {
        "home_reset.reset -> reset_hold.u",  # so that the command is constant between ticks
        "reset_hold.y -> finger_release.reset",
        "finger_gaps_hold.y -> finger_release.finger_gaps",
        "desired_posture_unscaling.y0 -> finger_release.desired_posture",
    }


def test_the_list_of_the_package_is_that_of_its_files():
    listed = re.findall(r"^([a-z_]+) {2,}\S", systems.__doc__, re.MULTILINE)
    assert sorted(listed) == sorted(path.stem for path in Path(systems.__file__).parent.glob("[a-z]*.py"))
