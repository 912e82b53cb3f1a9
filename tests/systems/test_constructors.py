"""Bad constructor arguments: a ValueError that names the value, the limit and the remedy."""

import numpy as np
import pytest

from systems.alpha_mixer import AlphaMixer
from systems.disturbance import Disturbance
from systems.image_encoder import ImageEncoder
from systems.loop_closer import LoopCloser
from systems.posture_history import PostureHistory
from systems.posture_regulator import make_posture_regulator
from systems.recall_detector import RecallDetector
from systems.recurrent_policy import RecurrentPolicy
from tests.systems.controller_fakes import FakeEncoder, FakePolicy, make_controller

ONES = np.ones(4)


def build(function, defaults):
    return lambda **changes: function(**(defaults | changes))


encoder = build(ImageEncoder, dict(encoder=FakeEncoder()))
history = build(PostureHistory, dict(posture_size=4, horizon=2, period=0.1, initial_posture=ONES))
closer = build(LoopCloser, dict(posture_size=4, feature_size=4))
detector = build(RecallDetector, dict(policy=FakePolicy(), joints=3))
regulator = build(
    make_posture_regulator, dict(posture_size=4, joints=3, initial_posture=ONES, Q=1.0, R=90.0, period=0.1)
)
FINGERS = dict(finger_openings=(-0.5, 0.5), finger_thresholds=(-0.1, 0.1))
mixer = build(AlphaMixer, dict(posture_size=4, joints=3, lower=-ONES, upper=ONES, max_step=ONES[:3]) | FINGERS)
disturbance = build(Disturbance, dict(posture_size=4))


def policy(period=0.1, **attributes):
    fake = FakePolicy()
    for name, value in attributes.items():
        setattr(fake, name, value)
    return RecurrentPolicy(fake, period)


def controller(**arguments):
    attributes = {n: arguments.pop(n) for n in ("feature_size",) if n in arguments}
    fake = FakePolicy()
    for name, value in attributes.items():
        setattr(fake, name, value)
    return make_controller(FakeEncoder(), fake, **arguments)


CASES = [
    (encoder, dict(width=64), "width is 64.*at least 112"),
    (encoder, dict(width=224), "224 x 112.*pass equal"),
    (encoder, dict(encoder=FakeEncoder(feature_size=0)), "feature_size is 0.*at least 1"),
    (policy, dict(period=0.0), "period is 0.0.*greater than 0"),
    (policy, dict(initial_state=np.zeros(3)), r"initial_state has shape \(3,\).*\(12,\)"),
    (history, dict(horizon=-1), "horizon is -1.*at least 0"),
    (history, dict(period=-0.1), "period is -0.1.*greater than 0"),
    (history, dict(initial_posture=np.full(4, np.nan)), "initial_posture is .*nan.*finite"),
    (closer, dict(posture_size=0), "posture_size is 0.*at least 1"),
    (closer, dict(feature_size=1.5), "feature_size is 1.5.*whole number"),
    (detector, dict(joints=5), "joints is 5.*at least 1 and at most 4"),
    (detector, dict(policy=FakePolicy(horizon=0)), "horizon is 0.*at least 1"),
    (regulator, dict(joints=5), "joints is 5.*at most 4"),
    (regulator, dict(Q=0.0), "Q is 0.0.*greater than 0"),
    (regulator, dict(R=np.diag([1.0, 1.0, -1.0])), "R has the eigenvalue -1.*positive definite"),
    (regulator, dict(R=np.eye(2)), r"R is .*shape \(3, 3\)"),
    (mixer, dict(lower=ONES), r"lower is .*swap or widen component\(s\) \[0, 1, 2, 3\]"),
    (mixer, dict(max_step=-ONES[:3]), "max_step.*at least 0"),
    (mixer, dict(max_step=ONES), r"max_step has shape \(4,\).*\(3,\)"),
    (mixer, dict(finger_openings=((), ())), r"finger_openings has shape \(0,\).*\(1,\)"),
    (mixer, dict(finger_openings=(-0.5, 1.5)), r"finger_openings are \(-0.5, 1.5\).*bounds .*open <= upper"),
    (mixer, dict(finger_thresholds=(0.1, 0.1)), r"finger_thresholds \(0.1, 0.1\).*closed below < open above"),
    (mixer, dict(finger_thresholds=(-0.6, 0.1)), r"finger_thresholds \(-0.6, 0.1\).*closed <= closed below"),
    (mixer, dict(joints=5), "joints is 5.*at least 0 and at most 4"),
    (disturbance, dict(posture_size=0), "posture_size is 0.*at least 1"),
    (disturbance, dict(period=0.0), "period is 0.0.*greater than 0"),
    (controller, dict(feature_size=5), "encoder gives 4 features, the policy takes 5"),
    (controller, dict(joint_lower=np.ones(3)), r"joint_lower has shape \(3,\).*\(4,\)"),
    (controller, dict(speed_limits=-ONES[:3]), "speed_limits.*at least 0"),
    (controller, dict(joints=0), "joints is 0.*at least 1"),
    (controller, dict(finger_thresholds=(2.0, 1.0)), "finger_thresholds.*closed below < open above"),
]


@pytest.mark.parametrize(("construct", "arguments", "message"), CASES)
def test_error_names_value_limit_and_remedy(construct, arguments, message):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        construct(**arguments)


def test_encoder_of_another_training_is_refused():
    fake_encoder, fake_policy = FakeEncoder(), FakePolicy()
    fake_encoder.hash, fake_policy.encoder_hash = "aa", "bb"
    with pytest.raises(ValueError, match="hash aa, the policy was trained with bb"):
        make_controller(fake_encoder, fake_policy)
    fake_encoder.hash = "bb"
    make_controller(fake_encoder, fake_policy)
