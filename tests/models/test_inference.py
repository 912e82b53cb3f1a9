"""What runs against what was trained: ONNX Runtime's graphs against the torch modules."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from models.data.demonstrations import iterate_frames
from models.files.container import WeightsError, file_hash
from models.files.graphs import write_graph
from models.files.policies import read_policy
from models.files.weights import load_autoencoder, load_policy, save_policy
from models.inference import Decoder, Encoder, Policy
from models.networks.cae import to_image
from models.networks.onnx_export import decoder_graph, encoder_graph
from models.training.export import ExportOptions, export, sample_pictures
from tests.models import handmade
from tests.models.conftest import make_policy

NUMBERS = """
import sys, hashlib, numpy as np
from models.inference import Encoder, Policy
encoder, policy = Encoder(sys.argv[1]), Policy(sys.argv[2])
rng, state, total = np.random.default_rng(0), policy.initial_state, hashlib.sha256()
for _ in range(20):
    features = encoder.encode(rng.integers(0, 256, (112, 112, 3), np.uint8))
    y, state, recalled = policy.step(np.concatenate([rng.uniform(-1, 1, 8), features]), state)
    total.update(y.tobytes() + state.tobytes() + recalled.tobytes())
print(total.hexdigest())
"""


@pytest.fixture(scope="module")
def exported(data_file: Path, autoencoder_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of encoder.onnx and decoder.onnx in 8 bits."""
    out = tmp_path_factory.mktemp("exported")
    export(ExportOptions(data=data_file, autoencoder=autoencoder_file, out=out, pictures=16))
    return out


def test_float_encoder_and_decoder_are_the_torch_modules(autoencoder_file, pictures, tmp_path):
    model, _ = load_autoencoder(autoencoder_file)
    write_graph(tmp_path / "encoder.onnx", encoder_graph(model).SerializeToString(), {"kind": "encoder"})
    write_graph(tmp_path / "decoder.onnx", decoder_graph(model).SerializeToString(), {"kind": "decoder"})
    features = Encoder(tmp_path / "encoder.onnx").encode_batch(pictures)
    with torch.inference_mode():
        wanted = model.encode(to_image(torch.from_numpy(pictures)))
        image = model.decode(wanted).permute(0, 2, 3, 1).numpy()
    assert np.abs(features).max() > 0.1
    np.testing.assert_allclose(features, wanted.numpy(), rtol=0, atol=1e-5)
    decoded = Decoder(tmp_path / "decoder.onnx").decode(features[0])
    assert (decoded.shape, decoded.dtype) == ((112, 112, 3), np.uint8)
    assert np.abs(decoded / 255.0 - image[0].clip(0, 1)).max() <= 0.5 / 255.0 + 1e-5


def test_8_bits_are_near_the_torch_module(exported, autoencoder_file, data_file):
    """Near on pictures like those that the ranges were taken from; what that is worth in millimetres, `probe` says."""
    model, _ = load_autoencoder(autoencoder_file)
    seen = next(iter(iterate_frames(data_file, ["demo_0"])))[1::7]
    encoder = Encoder(exported / "encoder.onnx")
    features = encoder.encode_batch(seen)
    with torch.inference_mode():
        wanted = model.encode(to_image(torch.from_numpy(seen)))
        image = model.decode(wanted[:1])[0].permute(1, 2, 0).numpy()
    assert features.std(0).max() > 0.05
    assert np.sqrt(np.mean((features - wanted.numpy()) ** 2)) < 0.1 * features.std()
    decoded = Decoder(exported / "decoder.onnx").decode(wanted[0].numpy())
    # Untrained, it makes noise of the size of a picture out of the last bits of a feature; trained, this is 0.002.
    image = image.clip(0, 1)
    assert np.sqrt(np.mean((decoded / 255.0 - image) ** 2)) < 0.2 * image.std()
    assert np.corrcoef(decoded.ravel(), image.ravel())[0, 1] > 0.95


def test_8_bits_are_8_bits(exported):
    assert (exported / "encoder.onnx").stat().st_size < 19_000_000  # float32: 75 million
    graph = onnx.load(exported / "encoder.onnx").graph
    large = [tensor.data_type for tensor in graph.initializer if np.prod(tensor.dims) > 2000]
    assert sorted(large) == [onnx.TensorProto.FLOAT] + [onnx.TensorProto.INT8] * 4  # the features' layer; the others
    assert {node.domain for node in graph.node} == {""}


def test_one_by_one_and_in_batches_are_the_same_bits(exported, pictures):
    encoder = Encoder(exported / "encoder.onnx")
    np.testing.assert_array_equal(
        encoder.encode_batch(np.tile(pictures, (20, 1, 1, 1)))[:4], np.stack([encoder.encode(p) for p in pictures])
    )
    assert encoder.encode_batch(pictures[:0]).shape == (0, 30)
    assert encoder.encode(pictures[0]).dtype == np.float64


def test_bits_are_equal_from_process_to_process(exported, tmp_path):
    save_policy(tmp_path / "lstm.onnx", make_policy())
    command = [sys.executable, "-c", NUMBERS, str(exported / "encoder.onnx"), str(tmp_path / "lstm.onnx")]
    runs = {subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2)}
    assert len(runs) == 1
    assert len(runs.pop().strip()) == 64


def test_pictures_for_the_ranges_are_training_pictures(data_file):
    train = np.concatenate(list(iterate_frames(data_file, [f"demo_{i}" for i in range(8)])))
    taken = sample_pictures(data_file, 10)
    assert 10 <= len(taken) <= 16
    assert all((train == picture).all(axis=(1, 2, 3)).any() for picture in taken)


def test_encoder_says_what_it_is_and_takes_a_view(encoder_file: Path, pictures: np.ndarray) -> None:
    encoder = Encoder(encoder_file)
    assert (encoder.feature_size, encoder.hash) == (30, file_hash(encoder_file))
    rgba = np.concatenate([pictures[0], np.full((112, 112, 1), 255, np.uint8)], axis=2)
    np.testing.assert_array_equal(encoder.encode(rgba[..., :3]), encoder.encode(pictures[0]))
    with pytest.raises(ValueError, match="uint8"):
        encoder.encode(pictures[0].astype(float))
    with pytest.raises(ValueError, match="112"):
        encoder.encode(pictures[0, :64])


@pytest.mark.parametrize("name", ["lstm", "gru", "mtrnn", "tests.models.outside:Elman"])
def test_policy_is_the_torch_module(tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.onnx"
    save_policy(path, make_policy(name))
    stored, policy = load_policy(path), Policy(path)  # only what was stored counts: it is rounded to 16 bits
    rng = np.random.default_rng(0)
    state = policy.initial_state
    for _ in range(30):
        x = rng.uniform(-1.0, 1.0, size=38)
        y, after, recalled = policy.step(x, state)
        with torch.no_grad():
            wanted = stored.rnn.step(torch.tensor(x).float()[None], torch.tensor(state).float()[None])
            wanted_recall = stored.recall(torch.tensor(after).float()[None])
        np.testing.assert_allclose(y, wanted[0][0].numpy(), rtol=0, atol=1e-5)
        np.testing.assert_allclose(after, wanted[1][0].numpy(), rtol=0, atol=1e-5)
        np.testing.assert_allclose(recalled, wanted_recall[0].numpy(), rtol=0, atol=1e-5)
        assert recalled.shape == (10, 8)
        state = after
    assert np.abs(state).max() > 0.01


def test_policy_s_attributes(tmp_path: Path) -> None:
    path = tmp_path / "p.onnx"
    save_policy(path, make_policy())
    policy = Policy(path)
    assert (policy.posture_size, policy.feature_size, policy.state_size, policy.horizon) == (8, 30, 500, 10)
    assert policy.initial_state.shape == (500,)
    assert not policy.initial_state.any()
    assert (policy.mean_errors, policy.beta, policy.gamma) == (None, None, None)
    assert (policy.hash, policy.name) == (file_hash(path), "lstm")
    assert policy.initial_posture.shape == (8,)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"posture": 7}, r"its recalled is float32 \(2, 7\), where float32 \(n, 8\), n from 1"),
        ({"features": 200_000}, r"its inputs have the sizes .*200008.*: fixed ones are needed"),
        ({"horizon": 3}, r"has 3 mean_errors, where 4 are needed\. Run diagrams/calibrate\.py on it again"),
    ],
)
def test_a_policy_of_other_sizes_is_refused(tmp_path, change, named):
    header = make_policy().header() | {"mean_errors": [1.0] * 3}
    write_graph(tmp_path / "p.onnx", handmade.policy(None, **change).SerializeToString(), header)
    with pytest.raises(WeightsError, match=named):
        Policy(tmp_path / "p.onnx")


def test_a_graph_of_another_kind_or_type_is_refused(tmp_path):
    content = handmade.encoder().SerializeToString()
    write_graph(tmp_path / "x.onnx", content, make_policy().header())
    with pytest.raises(WeightsError, match=r"picture -> features, where x, state -> y, next_state, recalled is needed"):
        Policy(tmp_path / "x.onnx")
    write_graph(tmp_path / "x.onnx", content, {"kind": "decoder"})
    with pytest.raises(WeightsError, match=r"kind 'decoder'.*'encoder'"):
        Encoder(tmp_path / "x.onnx")
    with pytest.raises(WeightsError, match="picture -> features, where features -> picture"):
        Decoder(tmp_path / "x.onnx")


def test_an_encoder_of_one_picture_at_a_time_is_refused(tmp_path):
    single = handmade.encoder()
    for port in (*single.graph.input, *single.graph.output):
        port.type.tensor_type.shape.dim[0].dim_value = 1
    write_graph(tmp_path / "x.onnx", single.SerializeToString(), {"kind": "encoder"})
    with pytest.raises(WeightsError, match=r"x\.onnx: its graph cannot be run .*Got: 2 Expected: 1"):
        Encoder(tmp_path / "x.onnx")


def test_a_graph_that_cannot_run_is_refused(tmp_path):
    broken = handmade.encoder()
    broken.graph.node[5].op_type = "NoSuchOperator"
    write_graph(tmp_path / "x.onnx", broken.SerializeToString(), {"kind": "encoder"})
    with pytest.raises(WeightsError, match=r"x\.onnx: its graph cannot be run .*NoSuchOperator"):
        Encoder(tmp_path / "x.onnx")


def test_mean_errors_are_a_list(tmp_path):
    for odd in (2.0, [[2.0]]):
        header = make_policy().header() | {"mean_errors": odd}
        write_graph(tmp_path / "p.onnx", handmade.policy(None).SerializeToString(), header)
        with pytest.raises(WeightsError, match=r"p\.onnx: .*mean_errors has the shape \(.*a list is needed"):
            read_policy(tmp_path / "p.onnx")


def test_the_runtime_says_nothing_itself(tmp_path, capfd):
    """Not even its allocator, of a tensor that would fill the address space."""
    broken = handmade.encoder()
    [rows] = [tensor for tensor in broken.graph.initializer if tensor.name == "rows"]
    del rows.dims[:]
    rows.dims.extend([2**31, 2**31])
    write_graph(tmp_path / "x.onnx", broken.SerializeToString(), {"kind": "encoder"})
    with pytest.raises(WeightsError, match=r"x\.onnx: its graph cannot be run"):
        Encoder(tmp_path / "x.onnx")
    assert capfd.readouterr().err == ""


def test_a_graph_that_fails_at_a_later_tick_is_named(tmp_path):
    """On zeros it takes row 0 of a table of one row; on what it is then given, another."""
    late = handmade.policy(None)
    late.graph.node.insert(0, onnx.helper.make_node("Gather", ["push", "row"], ["pushed"], axis=0))
    late.graph.node.insert(0, onnx.helper.make_node("Cast", ["largest"], ["row"], to=onnx.TensorProto.INT64))
    late.graph.node.insert(0, onnx.helper.make_node("ReduceMax", ["x"], ["largest"], keepdims=0))
    [add] = [node for node in late.graph.node if node.op_type == "Add"]
    add.input[1] = "pushed"
    write_graph(tmp_path / "p.onnx", late.SerializeToString(), make_policy().header())
    policy = Policy(tmp_path / "p.onnx")
    policy.step(np.zeros(38), policy.initial_state)
    with pytest.raises(WeightsError, match=r"p\.onnx: its graph cannot be run .*out of data bounds"):
        policy.step(np.full(38, 5.0), policy.initial_state)
