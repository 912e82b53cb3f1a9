"""The three trainings as a user starts them, on the tiny data set, and what they promise."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from models.data.demonstrations import read_demonstrations
from models.files.weights import WeightsError, file_hash, load_autoencoder, load_policy, save_policy
from models.inference import Policy
from models.networks.rnn import RNNS
from models.training.__main__ import main
from models.training.cae import CaeModule, CaeOptions, augment, load_frames, median_image
from models.training.recall import RecallModule, RecallOptions, train_recall
from models.training.rnn import RnnOptions, posture_scaling, train_rnn
from models.training.trainer import fit, step_generator
from tests.models.conftest import make_policy


@pytest.fixture(scope="module", params=sorted(RNNS))
def rnn_options(
    request: pytest.FixtureRequest, data_file: Path, encoder_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> RnnOptions:
    return RnnOptions(
        data=data_file,
        encoder=encoder_file,
        out=tmp_path_factory.mktemp("rnn"),
        features=data_file.with_name("features.npz"),  # encoded once
        rnn=request.param,
        steps=4,
        batch_size=4,
        checkpoint_every=2,
        validate_every=4,
        progress=False,
    )


@pytest.fixture(scope="module")
def candidate(rnn_options: RnnOptions) -> Path:
    return train_rnn(rnn_options)


def test_frames_are_the_training_demonstrations_only(data_file: Path) -> None:
    assert load_frames(data_file).shape == (400, 112, 112, 3)
    frames = load_frames(data_file, stride=7)
    assert len(frames) == sum(len(range(phase, 100, 7)) for phase in range(4))


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


def test_weighted_loss_counts_a_moving_pixel_sixteen_fold(data_file: Path, tmp_path: Path) -> None:
    frames = np.full((2, 112, 112, 3), 50, np.uint8)
    options = CaeOptions(data=data_file, out=tmp_path, noise=0.0, colour=0.0, feature_noise=0.0)
    losses = {}
    for weight in (1.0, 16.0):
        module = CaeModule(replace(options, foreground_weight=weight), frames, {})
        module.trainer = type("Trainer", (), {"global_step": 0})()
        module.log = lambda *_, **__: None
        module.model.decode = lambda f: torch.zeros(len(f), 3, 112, 112)
        batch = torch.full((2, 112, 112, 3), 50, dtype=torch.uint8)
        batch[:, :56] = 255
        losses[weight] = module.training_step(batch, 0).item()
    still, moving = (50 / 255) ** 2, 1.0
    assert losses[1.0] == pytest.approx((still + moving) / 2, rel=1e-5)
    assert losses[16.0] == pytest.approx((still + 16 * moving) / 17, rel=1e-5)


def test_cae_trains_writes_and_resumes_bit_for_bit(data_file: Path, tmp_path: Path) -> None:
    arguments = [
        "cae",
        "--data",
        str(data_file),
        "--max-images",
        "16",
        "--batch-size",
        "4",
        "--no-progress",
        "--checkpoint-every",
        "2",
        "--frame-stride",
        "10",
        "--out",
    ]
    kept = tmp_path / "resumed"
    kept.mkdir()
    original = CaeModule.export

    def export(self: CaeModule, step: int, final: bool) -> None:
        original(self, step, final)
        if step == 2 and not (kept / "last.ckpt").exists():
            shutil.copy(self.options.out / "last.ckpt", kept / "last.ckpt")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CaeModule, "export", export)
        assert main([*arguments, str(tmp_path / "whole")]) == 0
    assert main([*arguments, str(kept)]) == 0
    (whole, metadata), (resumed, _) = (load_autoencoder(tmp_path / n / "cae.safetensors") for n in ("whole", "resumed"))
    assert metadata["step"] == 4
    assert metadata["data_hash"] == "00" * 32
    assert metadata["training"]["max_images"] == 16
    for (name, a), b in zip(whole.state_dict().items(), resumed.state_dict().values(), strict=True):
        assert torch.equal(a, b), name


def test_scaling_holds_what_the_network_has_to_say(data_file: Path) -> None:
    demos = read_demonstrations(data_file, "train")
    initial = demos[0].posture[0]
    scaling = posture_scaling(demos, initial, 0.1, 1.1, 0.3)
    for one in demos:
        wanted = one.posture[1:] + 0.1 * (one.posture[:-1] - initial) * ([1] * 7 + [0])
        assert np.abs(scaling.scale(wanted)).max() < 1.0
        assert np.abs(scaling.scale(one.posture)).max() < 1.0
    assert scaling.half_range[:7].min() > 0.299 > scaling.half_range[7]


def test_rnn_writes_candidates_that_know_where_they_come_from(rnn_options: RnnOptions, candidate: Path) -> None:
    assert candidate.name == "rnn-4.safetensors"
    assert (rnn_options.out / "rnn-2.safetensors").is_file()
    policy = load_policy(candidate)
    assert policy.rnn.name == rnn_options.rnn
    assert policy.recall is None
    assert policy.regulator_gain == 0.1
    assert policy.metadata["training"]["steps"] == 4
    assert policy.metadata["data_hash"] == "00" * 32
    assert list((rnn_options.out / "logs").rglob("metrics.csv"))


def test_rnn_resumes_bit_for_bit(rnn_options: RnnOptions, candidate: Path, tmp_path: Path) -> None:
    short = replace(rnn_options, out=tmp_path)
    kept: list[bytes] = []

    def stop(self: object, step: int, final: bool) -> None:
        if step == 2:
            kept.append((tmp_path / "last.ckpt").read_bytes())
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("models.training.rnn.RnnModule.export", stop)
        with pytest.raises((KeyboardInterrupt, SystemExit)):
            train_rnn(short)
    assert kept
    resumed = load_policy(train_rnn(short))
    for a, b in zip(resumed.rnn.parameters(), load_policy(candidate).rnn.parameters(), strict=True):
        assert torch.equal(a, b)


def test_rnn_trained_further_knows_its_ancestor(rnn_options: RnnOptions, candidate: Path, tmp_path: Path) -> None:
    further = replace(rnn_options, start_from=candidate, out=tmp_path, learning_rate=0.0, final_rate=0.0, steps=1)
    ancestor, policy = load_policy(candidate), load_policy(train_rnn(further))
    for a, b in zip(policy.rnn.parameters(), ancestor.rnn.parameters(), strict=True):
        assert torch.equal(a, b)
    origin = {"hash": file_hash(candidate), "encoder_hash": ancestor.encoder_hash}
    assert policy.metadata["started_from"] == origin | ancestor.metadata
    assert policy.metadata["training"]["steps"] == 1


def test_rnn_is_not_trained_further_for_something_else(tmp_path: Path, data_file: Path, encoder_file: Path) -> None:
    start = tmp_path / "rnn-1.safetensors"
    save_policy(start, make_policy("gru", recall=False))
    options = RnnOptions(
        data=data_file, encoder=encoder_file, out=tmp_path, start_from=start, rnn="gru", progress=False
    )
    with pytest.raises(WeightsError, match="has the network gru, not lstm"):
        train_rnn(replace(options, rnn="lstm"))
    with pytest.raises(WeightsError, match=r"has the regulator gain 0\.1, not 0\.2"):
        train_rnn(replace(options, regulator_gain=0.2))
    elsewhere = make_policy("gru", recall=False)
    elsewhere.initial_posture = elsewhere.initial_posture + 0.1
    save_policy(start, elsewhere)
    with pytest.raises(WeightsError, match="has the initial posture"):
        train_rnn(options)


def test_recall_training_moves_no_main_weight(rnn_options: RnnOptions, candidate: Path, tmp_path: Path) -> None:
    options = RecallOptions(
        data=rnn_options.data,
        out=tmp_path,
        policy=(candidate,),
        encoder=rnn_options.encoder,
        features=rnn_options.features,
        steps=3,
        batch_size=4,
        progress=False,
    )
    (path,) = train_recall(options)
    assert path == tmp_path / "policy-4.safetensors"
    before, after = load_policy(candidate).rnn.state_dict(), load_policy(path).rnn.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    policy = Policy(path)
    assert policy.recall(policy.initial_state).shape == (10, 8)
    written = path.stat().st_mtime_ns
    train_recall(options)
    assert path.stat().st_mtime_ns == written


def test_frozen_network_goes_to_the_device_of_the_heads(data_file: Path, encoder_file: Path, tmp_path: Path) -> None:
    options = RecallOptions(data=data_file, out=tmp_path, policy=(), encoder=encoder_file)
    module = RecallModule(options, None, make_policy("gru", recall=False), tmp_path / "p").to("meta")
    assert {parameter.device.type for parameter in module.rnn.parameters()} == {"meta"}
    trained = module.configure_optimizers()["optimizer"].param_groups[0]["params"]
    assert len(trained) == len(list(module.heads.parameters()))


def test_recall_heads_learn(
    rnn_options: RnnOptions, candidate: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    errors = []
    for steps in (1, 60):
        train_recall(
            RecallOptions(
                data=rnn_options.data,
                out=tmp_path / str(steps),
                policy=(candidate,),
                batch_size=4,
                encoder=rnn_options.encoder,
                features=rnn_options.features,
                steps=steps,
                progress=False,
            )
        )
        errors.append(np.array(capsys.readouterr().out.strip().splitlines()[-1].split()[-10:], float))
    assert (errors[1] < 0.8 * errors[0]).all()


def test_recall_refuses_another_encoder(rnn_options: RnnOptions, tmp_path: Path) -> None:
    save_policy(tmp_path / "rnn-1.safetensors", make_policy(recall=False))
    with pytest.raises(WeightsError, match="another autoencoder"):
        train_recall(
            RecallOptions(
                data=rnn_options.data,
                out=tmp_path,
                policy=(tmp_path / "rnn-1.safetensors",),
                encoder=rnn_options.encoder,
                features=rnn_options.features,
                steps=1,
                progress=False,
            )
        )


def test_learning_rate_ends_at_a_hundredth(data_file: Path, tmp_path: Path) -> None:
    options = CaeOptions(data=data_file, out=tmp_path, max_images=6, batch_size=2, progress=False)
    module = CaeModule(options, np.zeros((6, 112, 112, 3), np.uint8), {})
    module.model = torch.nn.Linear(1, 1)
    module.training_step = lambda batch, batch_idx: module.model(batch.float().mean().reshape(1, 1) + 1).sum()
    module.export = lambda *_: None
    fit(module, options, 100)
    assert module.optimizers().param_groups[0]["lr"] == pytest.approx(1e-5, rel=1e-3)


def test_missing_data_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cae", "--data", str(tmp_path / "none.h5"), "--out", str(tmp_path)]) == 2
    assert "none.h5: the data set does not exist" in capsys.readouterr().err


def test_out_that_is_a_file_is_exit_code_2(data_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert main(["cae", "--data", str(data_file), "--out", str(tmp_path / "file")]) == 2
    assert "File exists" in capsys.readouterr().err


def test_each_network_is_trained_as_it_needs_unless_told(tmp_path):
    def options(**given):
        return RnnOptions(data=tmp_path / "d.h5", out=tmp_path, encoder=tmp_path / "cae.safetensors", **given)

    assert (options().steps, options().posture_weight, options().learning_rate) == (10_000, 4.0, 1e-3)
    mtrnn = options(rnn="mtrnn", posture_weight=4.0)
    assert (mtrnn.steps, mtrnn.posture_weight, mtrnn.learning_rate) == (16_000, 4.0, 4e-3)
    assert mtrnn.as_metadata()["learning_rate"] == 4e-3
