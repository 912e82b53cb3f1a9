"""What a tick of each detector costs: over an encoding of a picture, which a tick has anyway."""

import time

import numpy as np
import pytest

from diagrams.monitors.tapes import replay
from diagrams.world.names import ARM_JOINTS, ENCODER, WEIGHTS
from models.data.runs import Tape
from models.data.windows import decode_runs
from models.files.detectors import load_detector
from models.inference import Encoder, Policy
from systems import distillation_detector, flow_detector
from systems.detectors import DETECTORS

LIMIT = 0.45  # a millisecond, of some 2.2 that the encoding takes
LIMITS = {"knn": 2.0}  # its search takes the longer the farther the arm is from what was taught
IDLE = ("never", "oracle")  # nothing to measure


@pytest.fixture(scope="module")
def policy():
    return Policy(WEIGHTS / "lstm.onnx")


def tape(policy, ticks):
    """Noise of the sizes of the shipped networks; the arm goes along taught paths, nearly."""
    rng, size = np.random.default_rng(0), policy.posture_size
    shapes = (policy.horizon + 1, size), (policy.state_size,), (30,), (30,), ()
    taught = np.vstack(decode_runs(load_detector(WEIGHTS / "knn.safetensors", "knn").arrays))[:ticks]
    postures = policy.scaling.scale(np.hstack((taught, np.full((ticks, 1), 0.08)))) + 0.01 * rng.normal(size=(ticks, 8))
    return Tape(postures, *(rng.normal(size=(ticks, *shape)) for shape in shapes))


def arrays_of(name, given):
    source = getattr(DETECTORS[name], "learns_from", "postures")
    if source == "postures":
        return load_detector(WEIGHTS / f"{name}.safetensors", name).arrays
    if source == "policies":
        return DETECTORS[name].fit([(WEIGHTS / f"lstm{seed}.onnx").read_bytes() for seed in ("", "-1", "-2")])
    return DETECTORS[name].fit([given])


@pytest.mark.parametrize("name", [name for name in DETECTORS if name not in IDLE])
def test_a_tick_of_a_detector_over_an_encoding(policy, measure, in_turns, hold, monkeypatch, name):
    for module in (distillation_detector, flow_detector):
        monkeypatch.setattr(module, "UPDATES", 2)
    ticks = 200 if measure else 2
    detector = DETECTORS[name].build(policy, ARM_JOINTS, arrays_of(name, tape(policy, 1500 if measure else 100)))
    given, home = tape(policy, ticks), policy.scaling.scale(policy.initial_posture)
    encoder, picture = Encoder(WEIGHTS / ENCODER), np.zeros((112, 112, 3), np.uint8)

    def detected():
        begin = time.perf_counter()
        replay(detector, given, home)
        return time.perf_counter() - begin

    def encoded():
        begin = time.perf_counter()
        for _ in range(ticks):
            encoder.encode(picture)
        return time.perf_counter() - begin

    (ratio,) = in_turns(detected, encoded)
    hold(f"a tick of the detector {name} over an encoding", ratio, at_most=LIMITS.get(name, LIMIT))
