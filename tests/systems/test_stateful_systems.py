"""ImageEncoder, RecurrentPolicy, PostureHistory: hand-worked numbers at the ticks."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U

from systems.image_encoder import ImageEncoder
from systems.posture_history import PostureHistory
from systems.recurrent_policy import RecurrentPolicy
from tests.systems.controller_fakes import PERIOD, FakeEncoder, FakePolicy, image
from tests.systems.system_checks import evaluate


class RecordingEncoder(FakeEncoder):
    """Keeps the last image."""

    def encode(self, rgb):
        self.image = rgb.copy()
        return super().encode(rgb)


def test_image_encoder_drops_the_alpha_channel():
    picture = image(0)
    picture.mutable_data[3, 7] = [10, 20, 30, 255]
    encoder = RecordingEncoder(feature_size=2)
    features = evaluate(ImageEncoder(encoder), "features", dict(rgb_image=picture))
    assert encoder.image.shape == (112, 112, 3)
    assert encoder.image[3, 7].tolist() == [10, 20, 30]  # row 3, column 7
    mean = 60.0 / (112 * 112 * 3) / 255.0
    assert features == pytest.approx([mean / 2.0, mean])


def test_image_encoder_averages_a_larger_image_down():
    picture = image(0, 224)
    picture.mutable_data[6:8, 14:16] = [[[0] * 4, [40] * 4], [[80] * 4, [120] * 4]]
    encoder = RecordingEncoder()
    evaluate(ImageEncoder(encoder, 224, 224), "features", dict(rgb_image=picture))
    assert encoder.image.shape == (112, 112, 3)
    assert encoder.image[3, 7].tolist() == [60, 60, 60]
    assert encoder.image.sum() == 180


def test_image_encoder_refuses_another_size_and_encodes_once():
    encoder = FakeEncoder()
    system = ImageEncoder(encoder)
    context = system.CreateDefaultContext()
    port = system.GetOutputPort("features")
    system.GetInputPort("rgb_image").FixValue(context, image())
    port.Eval(context)
    context.SetTime(1.0)
    port.Eval(context)
    assert encoder.calls == 1
    system.GetInputPort("rgb_image").FixValue(context, ImageRgba8U(64, 112))
    with pytest.raises(ValueError, match="64 x 112 pixels, the encoder was built for 112 x 112"):
        port.Eval(context)


def outputs(system, context):
    return {
        port.get_name(): port.Eval(context) for port in map(system.get_output_port, range(system.num_output_ports()))
    }


def test_posture_history_by_hand():
    system = PostureHistory(posture_size=2, horizon=2, period=0.5, initial_posture=[7.0, 8.0])
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    assert outputs(system, context)["posture_history"].tolist() == [7.0, 8.0] * 3
    port = system.GetInputPort("posture")
    port.FixValue(context, [1.0, 2.0])
    simulator.AdvanceTo(0.1)
    port.FixValue(context, [3.0, 4.0])
    simulator.AdvanceTo(0.4)  # no tick in between: held
    assert outputs(system, context)["posture"].tolist() == [1.0, 2.0]
    assert outputs(system, context)["posture_history"].tolist() == [1.0, 2.0, 7.0, 8.0, 7.0, 8.0]
    simulator.AdvanceTo(0.6)
    assert outputs(system, context)["posture"].tolist() == [3.0, 4.0]
    assert outputs(system, context)["posture_history"].tolist() == [3.0, 4.0, 1.0, 2.0, 7.0, 8.0]


def test_recurrent_policy_by_hand():
    policy = FakePolicy(joints=1, feature_size=1, horizon=2, drift=0.25, nonsense=0.125)
    initial = policy.scaling.scale(policy.initial_posture)
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    found = outputs(system, context)
    assert found["predicted_posture"] == pytest.approx(initial)
    assert found["predicted_features"].tolist() == [0.0]
    assert found["hidden_state"] == pytest.approx(policy.initial_state)
    assert found["recalled_postures"] == pytest.approx(np.concatenate((initial, initial + 0.125, initial + 0.125)))

    port = system.GetInputPort("network_input")
    port.FixValue(context, [0.5, -0.25, 1.0])
    simulator.AdvanceTo(0.5 * PERIOD)
    found = outputs(system, context)
    assert found["predicted_posture"].tolist() == [0.75, 0.0]
    assert found["predicted_features"].tolist() == [0.5]
    # Row 0: the prediction made before this tick; rows 1, 2: recalled from the new hidden state.
    assert found["recalled_postures"] == pytest.approx(np.concatenate((initial, initial + 0.125, initial + 0.125)))

    port.FixValue(context, [1.0, -2.0, 4.0])
    simulator.AdvanceTo(1.5 * PERIOD)
    found = outputs(system, context)
    assert found["predicted_posture"].tolist() == [1.0, -1.0]  # 1.25, -1.75 clipped
    assert found["predicted_features"].tolist() == [1.0]  # 2 clipped
    expected = np.concatenate(([0.75, 0.0], [0.625, -0.125], initial + 0.125))
    assert found["recalled_postures"] == pytest.approx(expected)


def test_recurrent_policy_stops_at_values_that_are_not_finite():
    policy = FakePolicy()
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    system.GetInputPort("network_input").FixValue(simulator.get_mutable_context(), np.full(8, np.nan))
    with pytest.raises(ValueError, match=r"t = 0 s has values that are not finite.*check the weights"):
        simulator.AdvanceTo(0.01)


def test_a_policy_that_writes_to_its_state_does_no_harm():
    policy = FakePolicy()
    step = policy.step

    def writing_step(x, state):
        y, after = step(x, state)
        state[:] = 1e9
        return y, after

    policy.step = writing_step
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("network_input").FixValue(context, np.zeros(8))
    for k in range(2):
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        assert np.abs(outputs(system, context)["hidden_state"]).max() < 2.0
