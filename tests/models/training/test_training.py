"""The trainings as a user starts them, on the tiny data set, and what each promises."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from models.data.augmentation import Augmentation
from models.data.demonstrations import iterate_frames, read_demonstrations
from models.errors import InputError
from models.files.container import WeightsError, file_hash
from models.files.weights import load_policy, save_policy
from models.inference import Policy
from models.networks import NETWORKS
from models.training.__main__ import main, parse
from models.training.cae import CaeOptions, CaeTraining, augment, load_frames, median_image, shifted
from models.training.recall import RecallOptions, RecallTraining, train_recall
from models.training.rnn import RnnOptions, RnnTraining, posture_scaling, train_rnn
from models.training.trainer import step_generator
from tests.models import synthetic
from tests.models.conftest import make_policy
from tests.models.data.test_sequences import random_pack
from tests.models.outside import Elman


@pytest.fixture(scope="module")
def candidate(rnn_options: RnnOptions, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train_rnn(replace(rnn_options, out=tmp_path_factory.mktemp("rnn")))


@pytest.fixture
def recall_options(rnn_options: RnnOptions, candidate: Path, tmp_path: Path) -> RecallOptions:
    return RecallOptions(
        data=rnn_options.data,
        out=tmp_path,
        policy=(candidate,),
        encoder=rnn_options.encoder,
        features=rnn_options.features,
        steps=3,
        batch_size=4,
    )


def test_frames_are_the_training_demonstrations_only(data_file: Path) -> None:
    frames = load_frames(data_file)
    assert frames.shape == (400, 112, 112, 3)
    names = [demo.name for demo in read_demonstrations(data_file, "train")]
    assert np.array_equal(frames[100:200], next(iterate_frames(data_file, names[1:])))


def test_median_image_is_what_stands_still() -> None:
    frames = np.full((9, 112, 112, 3), 7, np.uint8)
    frames[2, 5:9] = 200
    assert (median_image(frames) == 7).all()


def test_augmentation_is_small_and_repeatable() -> None:
    image = torch.rand(3, 3, 112, 112)
    one = augment(image, 0.02, 0.05, step_generator(0, 5))
    assert torch.equal(one, augment(image, 0.02, 0.05, step_generator(0, 5)))
    assert not torch.equal(one, augment(image, 0.02, 0.05, step_generator(0, 6)))
    assert 0.005 < (one - image).square().mean().sqrt() < 0.08
    assert torch.equal(augment(image, 0.0, 0.0, step_generator(0, 5)), (image - 0.5) + 0.5)


def test_shifted_pictures_are_moved_whole_and_their_masks_with_them() -> None:
    image = torch.arange(2 * 3 * 6 * 6.0).reshape(2, 3, 6, 6)
    mask = image[:, :1] % 5 == 0
    seen = set()
    for step in range(40):
        moved, also = shifted(image, mask, 1, step_generator(0, step))
        assert torch.equal(also, moved[:, :1] % 5 == 0)
        for before, after in zip(image, moved, strict=True):
            # Off the edges it is the same picture, dy rows and dx columns on.
            dy, dx = next((y, x) for y in (0, 1, 2) for x in (0, 1, 2) if after[0, 1, 1] == before[0, y, x])
            assert torch.equal(after[:, 1:5, 1:5], before[:, dy : dy + 4, dx : dx + 4])
            assert after[0, 0, 0] == before[0, max(dy - 1, 0), max(dx - 1, 0)]  # the edges repeat
            seen.add((dy, dx))
    assert len(seen) == 9
    assert torch.equal(shifted(image, mask, 0, step_generator(0, 0))[0], image)


def test_weighted_loss_counts_a_moving_pixel_sixteen_fold(data_file: Path, tmp_path: Path) -> None:
    frames = np.full((2, 112, 112, 3), 50, np.uint8)
    options = CaeOptions(data=data_file, out=tmp_path, noise=0.0, colour=0.0, feature_noise=0.0, shift=0)
    losses = {}
    for weight in (1.0, 16.0):
        training = CaeTraining(replace(options, foreground_weight=weight), frames, {})
        training.model.decode = lambda f: torch.zeros(len(f), 3, 112, 112)
        batch = torch.full((2, 112, 112, 3), 50, dtype=torch.uint8)
        batch[:, :56] = 255
        losses[weight] = training.loss(batch, 0)[0].item()
    still, moving = (50 / 255) ** 2, 1.0
    assert losses[1.0] == pytest.approx((still + moving) / 2, rel=1e-5)
    assert losses[16.0] == pytest.approx((still + 16 * moving) / 17, rel=1e-5)


def test_precision_is_what_the_processor_multiplies(
    data_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = CaeOptions(data=data_file, out=tmp_path, device="cpu")
    for capabilities, precision in (
        ({"avx512_bf16": True}, "bfloat16"),
        ({"avx512_bf16": False}, "float32"),
        ({}, "float32"),
    ):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda found=capabilities: found)
        assert options.with_precision().as_metadata()["precision"] == precision
        assert replace(options, precision="bfloat16").with_precision().precision == "bfloat16"


def test_bfloat16_takes_the_layers_alone(data_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("models.networks.cae.HIDDEN", 20)
    frames = load_frames(data_file)
    losses, gradients = [], []
    for precision, expected in (("float32", torch.float32), ("bfloat16", torch.bfloat16)):
        torch.manual_seed(0)
        training = CaeTraining(CaeOptions(data=data_file, out=tmp_path, precision=precision), frames, {})
        layers = training.model
        seen: list[torch.dtype] = []
        for layer in (layers.encoder.conv1, layers.encoder.full, layers.decoder.deconv0, layers.decoder.output):
            layer.register_forward_hook(lambda _module, _inputs, out, seen=seen: seen.append(out.dtype))
        loss, _ = training.loss(training.make_batch(0), 0)
        loss.backward()
        assert seen == [expected] * 4
        assert {loss.dtype, *(parameter.grad.dtype for parameter in training.parameters())} == {torch.float32}
        losses.append(loss.item())
        gradients.append(layers.decoder.output.weight.grad.flatten())
    assert losses[1] == pytest.approx(losses[0], rel=0.01)
    assert torch.cosine_similarity(*gradients, dim=0) > 0.99


def test_scaling_holds_what_the_network_has_to_say(data_file: Path) -> None:
    demos = read_demonstrations(data_file, "train")
    scaling = posture_scaling(demos, 1.1, 0.3)
    for one in demos:
        assert np.abs(scaling.scale(one.posture)).max() < 1.0
    assert scaling.half_range[:7].min() > 0.299 > scaling.half_range[7]


@pytest.mark.parametrize("name", list(NETWORKS))
def test_each_network_trains_and_knows_where_it_comes_from(rnn_options: RnnOptions, tmp_path: Path, name: str) -> None:
    path = train_rnn(replace(rnn_options, rnn=name, out=tmp_path, steps=2, posture_weight=None))
    policy = load_policy(path)
    assert (path.name, policy.rnn.name, policy.recall) == ("rnn-2.onnx", name, None)
    training = policy.metadata["training"]
    assert (training["steps"], training["posture_weight"]) == (2, NETWORKS[name].training_defaults["posture_weight"])
    assert (policy.metadata["data_hash"], policy.metadata["world"]) == ("00" * 32, synthetic.WORLD)


def test_network_from_outside_goes_all_the_way(rnn_options: RnnOptions, tmp_path: Path) -> None:
    files = (
        f"--data {rnn_options.data} --encoder {rnn_options.encoder} --features {rnn_options.features} --out {tmp_path}"
    )
    spec = f"{Elman.__module__}:Elman"
    assert main(parse(f"rnn --rnn {spec} {files} --batch-size 4".split())) == 0
    candidate = tmp_path / "rnn-3.onnx"
    assert isinstance(load_policy(candidate).rnn, Elman)
    assert main(parse(f"recall --policy {candidate} {files} --batch-size 4 --steps 2".split())) == 0
    policy = Policy(tmp_path / "policy-3.onnx")
    assert policy.metadata["training"]["rnn"] == spec
    y, state, recalled = policy.step(np.zeros(38), policy.initial_state)
    assert (y.shape, state.shape, recalled.shape) == ((38,), (40,), (10, 8))
    stored = load_policy(candidate).rnn
    wanted = stored.step(torch.zeros(1, 38), torch.zeros(1, 40))[0][0]
    np.testing.assert_allclose(y, wanted.detach().numpy(), rtol=0, atol=1e-6)
    save_policy(tmp_path / "again.onnx", load_policy(candidate))
    assert file_hash(tmp_path / "again.onnx") == file_hash(candidate)


def test_network_that_is_not_here_is_named(tmp_path: Path, rnn_options: RnnOptions) -> None:
    policy = make_policy("lstm", recall=False)
    for spec, named in (("absent.place:Net", "absent"), ("tests.models.outside:NoNetwork", "is no RecurrentNetwork")):
        policy.rnn.spec = spec
        save_policy(tmp_path / "p.onnx", policy)
        with pytest.raises(WeightsError, match=rf"p\.onnx: its network cannot be built .*{named}.*Install"):
            load_policy(tmp_path / "p.onnx")
        with pytest.raises(InputError, match=named):
            train_rnn(replace(rnn_options, rnn=spec, out=tmp_path))


def test_no_tensor_of_an_update_or_validation_stays_behind_on_the_cpu(
    rnn_options: RnnOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the device "meta", whose tensors hold no numbers and refuse to be mixed with others'."""
    to_list, run = torch.Tensor.tolist, lambda rnn, batch, state: rnn(batch.x, batch.closed, state)
    monkeypatch.setattr(torch.Tensor, "tolist", lambda t: [True] * len(t) if t.is_meta else to_list(t))
    monkeypatch.setattr(torch.Tensor, "__float__", lambda t: 0.0)
    for module in ("rnn", "metrics"):
        monkeypatch.setattr(f"models.training.{module}.run", run)
    for name in ("gru", "mtrnn"):
        policy = make_policy(name, recall=False)
        pack = random_pack(4, 25, 10)
        training = RnnTraining(replace(rnn_options, rnn=name, out=tmp_path), pack, pack, policy).to("meta")
        loss, figures = training.loss(training.make_batch(0), 0)
        loss.backward()
        assert {value.device.type for value in (loss, *figures.values())} == {"meta"}
        assert all(parameter.grad.is_meta for parameter in training.parameters())
        assert set(training.validate(2)) >= {"open", "auto", "start", "done"}


def test_rnn_trained_further_knows_its_ancestor(rnn_options: RnnOptions, candidate: Path, tmp_path: Path) -> None:
    further = replace(rnn_options, start_from=candidate, out=tmp_path, learning_rate=0.0, final_rate=0.0, steps=1)
    ancestor, policy = load_policy(candidate), load_policy(train_rnn(further))
    for a, b in zip(policy.rnn.parameters(), ancestor.rnn.parameters(), strict=True):
        assert torch.equal(a, b)
    origin = {"hash": file_hash(candidate), "encoder_hash": ancestor.encoder_hash}
    assert policy.metadata["started_from"] == origin | ancestor.metadata
    assert policy.metadata["training"]["steps"] == 1


def test_rnn_is_not_trained_further_for_something_else(rnn_options: RnnOptions, tmp_path: Path) -> None:
    start = tmp_path / "rnn-1.onnx"
    save_policy(start, make_policy("gru", recall=False))
    options = replace(rnn_options, out=tmp_path, start_from=start, rnn="gru")
    with pytest.raises(WeightsError, match="has the network gru, not lstm"):
        train_rnn(replace(options, rnn="lstm"))
    elsewhere = make_policy("gru", recall=False)
    elsewhere.initial_posture = elsewhere.initial_posture + 0.1
    save_policy(start, elsewhere)
    with pytest.raises(WeightsError, match="has the initial posture"):
        train_rnn(options)


def test_recall_training_moves_no_main_weight(recall_options: RecallOptions, candidate: Path, tmp_path: Path) -> None:
    (path,) = train_recall(recall_options)
    assert path == tmp_path / "policy-4.onnx"
    before, after = load_policy(candidate).rnn.state_dict(), load_policy(path).rnn.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    written = path.stat().st_mtime_ns
    train_recall(recall_options)
    assert path.stat().st_mtime_ns == written


def test_recall_that_is_done_is_not_taken_for_another(
    recall_options: RecallOptions, candidate: Path, tmp_path: Path, grown_data_file: Path
) -> None:
    train_recall(recall_options)
    with pytest.raises(InputError, match=r"policy-4\.onnx was made with data [0-9a-f]{64}, not [0-9a-f]{64}"):
        train_recall(replace(recall_options, data=grown_data_file))
    with pytest.raises(InputError, match=r"policy-4\.onnx was made with learning_rate 0\.002, not 0\.1"):
        train_recall(replace(recall_options, learning_rate=0.1))
    policy = load_policy(candidate)
    with torch.no_grad():
        policy.rnn.output.bias += 1.0
    other = tmp_path / "rnn-4.onnx"
    save_policy(other, policy)
    with pytest.raises(InputError, match="was made from another network than"):
        train_recall(replace(recall_options, policy=(other,)))


def test_only_the_heads_are_trained(recall_options: RecallOptions, tmp_path: Path) -> None:
    training = RecallTraining(recall_options, None, make_policy("gru", recall=False), tmp_path / "p")
    trained = {name for name, parameter in training.named_parameters() if parameter.requires_grad}
    assert trained == {f"heads.{name}" for name, _ in training.heads.named_parameters()}


def test_recall_heads_learn(recall_options: RecallOptions, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    errors = []
    for steps in (1, 60):
        train_recall(replace(recall_options, out=tmp_path / str(steps), steps=steps))
        errors.append(np.array(capsys.readouterr().out.strip().splitlines()[-1].split()[-10:], float))
    assert (errors[1] < 0.8 * errors[0]).all()


def test_recall_refuses_another_encoder(recall_options: RecallOptions, tmp_path: Path) -> None:
    save_policy(tmp_path / "rnn-1.onnx", make_policy(recall=False))
    with pytest.raises(WeightsError, match="another encoder"):
        train_recall(replace(recall_options, policy=(tmp_path / "rnn-1.onnx",)))


def test_each_network_is_trained_as_it_needs_unless_told(rnn_options: RnnOptions) -> None:
    def options(**given) -> RnnOptions:
        unset = {"steps": None, "posture_weight": None, "learning_rate": None}
        return replace(rnn_options, **unset | given).with_defaults()

    lstm = options(rnn="lstm")
    assert (lstm.steps, lstm.posture_weight, lstm.learning_rate) == (6_000, 60.0, 2.5e-3)
    mtrnn = options(rnn="mtrnn", posture_weight=4.0)
    assert (mtrnn.steps, mtrnn.posture_weight, mtrnn.learning_rate) == (32_000, 4.0, 4e-3)
    assert mtrnn.as_metadata()["learning_rate"] == 4e-3


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"batch_size": 0}, "--batch-size 0 is out of range: choose a number above 0"),
        ({"batch_size": 10**6}, "--batch-size 1000000 is too large: choose at most 4096"),
        ({"steps": 10**12}, "--steps 1000000000000 is too large"),
        ({"augmentation": Augmentation(rest_ticks=10**6)}, "--augmentation.rest-ticks 1000000 is too large"),
        ({"posture_weight": -1.0}, "--posture-weight -1.0 is out of range: choose a number 0 or more"),
        ({"learning_rate": float("nan")}, "--learning-rate nan is out of range"),
        ({"scaling_margin": 0.0}, "--scaling-margin 0.0 is out of range: choose a number above 0"),
        ({"carry_over": 1.5}, "--carry-over 1.5 is out of range: choose a number from 0 to 1"),
        ({"augmentation": Augmentation(knot_ticks=0)}, "--augmentation.knot-ticks 0 is out of range"),
        ({"augmentation": Augmentation(loop_probability=2.0)}, "--augmentation.loop-probability 2.0 is out of range"),
    ],
)
def test_numbers_out_of_range_are_refused(rnn_options: RnnOptions, change: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        replace(rnn_options, **change)


@pytest.mark.parametrize("device", ["meta", "nowhere", "cuda:77"])
def test_a_device_that_cannot_compute_is_refused_at_once(rnn_options: RnnOptions, tmp_path: Path, device: str) -> None:
    with pytest.raises(InputError, match=f"--device {device} cannot be used .*: choose auto, or cpu"):
        train_rnn(replace(rnn_options, device=device, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_two_candidates_of_one_name_are_refused_at_once(recall_options: RecallOptions, tmp_path: Path) -> None:
    twice = replace(recall_options, policy=("a/rnn-4.onnx", "b/rnn-4.onnx"), out=tmp_path)
    with pytest.raises(InputError, match=r"a/rnn-4\.onnx b/rnn-4\.onnx would be written to one file"):
        train_recall(twice)


def test_carry_ticks_beyond_the_data_are_refused(rnn_options: RnnOptions, tmp_path: Path) -> None:
    beyond = replace(rnn_options, augmentation=Augmentation(carry_ticks=49), out=tmp_path)
    with pytest.raises(InputError, match=r"--augmentation\.carry-ticks 49 is more than the \d+ ticks of the shortest"):
        train_rnn(beyond)


def test_a_log_that_is_none_is_refused_and_left_alone(rnn_options: RnnOptions, tmp_path: Path) -> None:
    train_rnn(replace(rnn_options, out=tmp_path, steps=2))
    (tmp_path / "rnn-validation.csv").write_bytes(b"update,open\nmine,\x80\n")
    before = (tmp_path / "rnn.csv").read_bytes()
    with pytest.raises(InputError, match=r"rnn-validation\.csv is no log of a training .*choose another --out"):
        train_rnn(replace(rnn_options, out=tmp_path, steps=2))
    assert (tmp_path / "rnn.csv").read_bytes() == before


def test_without_training_demonstrations_nothing_is_scaled() -> None:
    with pytest.raises(InputError, match="the split train has no demonstration: teach more"):
        posture_scaling([], 1.1, 0.3)
