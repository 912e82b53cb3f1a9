"""The registry of the detectors: ours, and one from outside, from its fit to the controller."""

import numpy as np
import pytest

from models.data.runs import Tape
from models.errors import InputError
from systems import distillation_detector, flow_detector
from systems.detector import check_detector
from systems.detectors import DETECTORS
from tests.systems.controller_fakes import ClosedLoop, FakePolicy, TickArm, make_controller

OUTSIDE = "tests.systems.outside_detector:FarFromHome"


def test_names_are_those_of_the_classes():
    assert {"recall", "knn", "subspace", "innovation", "never", "oracle"} < set(DETECTORS)
    assert [DETECTORS[name].name for name in DETECTORS] == list(DETECTORS)
    assert DETECTORS.label(OUTSIDE) == "far"
    with pytest.raises(
        InputError,
        match=r"no detector 'svm': choose from recall, knn, subspace, .*, never, oracle, or give one as package",
    ):
        DETECTORS["svm"]


@pytest.mark.parametrize("name", ["recall", "knn", "subspace"])
def test_what_is_fitted_is_what_is_built_and_it_never_fires(name):
    policy = FakePolicy(horizon=10, nonsense=0.1)
    rng = np.random.default_rng(0)
    runs = [rng.normal(size=(30, 3)) for _ in range(2)]
    detector = DETECTORS[name].build(policy, 3, DETECTORS[name].fit(runs))
    controller = make_controller(policy=policy, detector=detector)
    loop = ClosedLoop(
        controller, TickArm(policy.initial_posture + 1.0), (np.ones(11 if name == "recall" else 3), 1, 1e12)
    )
    for k in range(3):
        loop.after_tick(k)
        assert loop.output("alpha")[0] < 1e-200
        assert (loop.output("errors").max() > 1e-3) == (name != "never")


def test_the_network_alone_notices_nothing():
    policy, never = FakePolicy(), DETECTORS["never"]
    detector = never.build(policy, 3, never.fit([np.ones((9, 3))]))
    loop = ClosedLoop(
        make_controller(policy=policy, detector=detector), TickArm(policy.initial_posture + 1.0), ([1], 1, 1)
    )
    for k in range(3):
        loop.after_tick(k)
        assert (loop.output("alpha")[0], loop.output("errors").tolist()) == (0.0, [0.0])


def test_a_detector_from_outside_takes_the_place():
    policy = FakePolicy()
    detector = DETECTORS[OUTSIDE].build(policy, 3, DETECTORS[OUTSIDE].fit([np.array([[9.0, 0.2], [9.0, -0.5]])]))
    far = abs(policy.scaling.scale(policy.initial_posture)[1]) / 0.5
    arm = TickArm(policy.initial_posture)
    loop = ClosedLoop(make_controller(policy=policy, detector=detector), arm, ([far / 3.0], 2.0, 2.5)).after_tick(0)
    assert loop.output("errors") == pytest.approx([3.0])
    assert loop.output("alpha") == pytest.approx([1.0 / (1.0 + np.exp(-1.0))])


def learned(name, policy):
    """What the detector learns from three runs of an arm that stands still, seen by noisy features."""
    source, rng = DETECTORS[name].learns_from, np.random.default_rng(0)
    size = policy.posture_size, policy.horizon + 1, policy.state_size, policy.feature_size
    if source != "network":
        return DETECTORS[name].fit([])
    tapes = []
    for _ in range(3):
        m, c, f, p = (rng.normal(0.0, 0.1, (40, n)) for n in (size[0], size[2], size[3], size[3]))
        tapes.append(Tape(m, np.repeat(m[:, None] + 0.1, size[1], axis=1), c, f, p, np.zeros(40)))
    return DETECTORS[name].fit(tapes)


NEW = [name for name in DETECTORS if name not in ("recall", "knn", "subspace", "never", "ensemble")]


@pytest.mark.parametrize("name", [*NEW, "pyod:ECOD"])
def test_each_runs_in_the_loop_to_the_same_bits(name, monkeypatch):
    """In a loop whose arm is off at first: errors and alpha of eight ticks, twice; the raw errors say something."""
    for module in (distillation_detector, flow_detector):
        monkeypatch.setattr(module, "UPDATES", 3)

    def run():
        policy = FakePolicy(nonsense=0.1)
        detector = DETECTORS[name].build(policy, 3, learned(name, policy))
        check_detector(detector, policy)
        controller = make_controller(policy=policy, detector=detector, home_tolerance=0.01)
        criteria = detector.GetOutputPort("errors").size()
        loop = ClosedLoop(controller, TickArm(policy.initial_posture + 1.0), (np.full(criteria, 1e-3), 2.0, 1.0))
        found = []
        for k in range(8):
            loop.after_tick(k)
            found += [loop.output("errors").copy(), loop.output("alpha").copy()]
        return found

    first, second = run(), run()
    assert [value.tobytes() for value in first] == [value.tobytes() for value in second]
    assert all(0.0 <= alpha[0] <= 1.0 for alpha in first[1::2])
    assert max(errors.max() for errors in first[::2]) > 0.0


@pytest.mark.parametrize(("name", "needed"), [("knn", "angles', 'lengths"), ("subspace", "axes")])
def test_a_file_with_other_arrays_is_refused(name, needed):
    with pytest.raises(InputError, match=rf"it holds \['a'\], where \['{needed}'\] are needed: fit it again"):
        DETECTORS[name].build(FakePolicy(), 3, {"a": np.zeros(1)})
