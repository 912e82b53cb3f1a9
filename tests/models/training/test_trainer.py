"""Trainings that are killed, stopped or started again: what is on disk is always that of an unbroken one."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from models.errors import InputError
from models.files.container import file_hash
from models.files.weights import load_autoencoder, load_policy
from models.interrupts import Interrupted, listening
from models.training.__main__ import main, parse
from models.training.cae import CaeOptions, train_cae
from models.training.recall import RecallOptions, train_recall
from models.training.rnn import RnnOptions, RnnTraining, train_rnn
from models.training.trainer import Training, device_of


class Killed(BaseException):
    pass


@pytest.fixture(scope="module")
def unbroken(rnn_options: RnnOptions, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train_rnn(replace(rnn_options, out=tmp_path_factory.mktemp("unbroken")))


@pytest.fixture
def options(rnn_options: RnnOptions, tmp_path: Path) -> RnnOptions:
    return replace(rnn_options, out=tmp_path)


def kill_at(monkeypatch: pytest.MonkeyPatch, number: int, after: bool, train: Callable[[], object]) -> bool:
    """Ends the training at the so many-th os.replace, before it or after it; False where there are not so many."""
    calls, replace_file = [], os.replace

    def dying(source, target) -> None:
        calls.append(target)
        if len(calls) < number or after:
            replace_file(source, target)
        if len(calls) == number:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", dying)
        try:
            train()
        except Killed:
            return True
    return False


def test_a_seed_that_no_generator_takes_is_refused(options: RnnOptions) -> None:
    with pytest.raises(InputError, match=r"--seed 10000000000 is too large: choose at most 1000000000"):
        replace(options, seed=10**10)


@pytest.mark.parametrize("after", [False, True])
def test_killed_at_any_write_the_same_command_ends_in_the_same_files(
    options: RnnOptions, unbroken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    wanted = {path.name: file_hash(path) for path in unbroken.parent.glob("rnn-*.onnx")}
    assert set(wanted) == {"rnn-2.onnx", "rnn-4.onnx"}
    number = 1
    while True:
        own = replace(options, out=tmp_path / str(number), features=tmp_path / str(number) / "features.npz")
        own.out.mkdir()
        (own.out / "features.npz").write_bytes(options.features.read_bytes())
        if not kill_at(monkeypatch, number, after, lambda own=own: train_rnn(own)):
            break
        train_rnn(own)
        assert {path.name: file_hash(path) for path in own.out.glob("rnn-*.onnx")} == wanted
        for log in ("rnn.csv", "rnn-validation.csv"):
            assert (own.out / log).read_text() == (unbroken.parent / log).read_text()
        number += 1
    assert number == 5  # two candidates and two checkpoints were written


def test_autoencoder_resumes_bit_for_bit(data_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("models.networks.cae.HIDDEN", 20)  # a hundredth of the weights

    def train(out: Path) -> None:
        command = f"cae --data {data_file} --out {out} --max-images 8 --batch-size 4 --checkpoint-every 1 --device cpu"
        assert main(parse(command.split())) == 0

    train(tmp_path / "whole")
    assert kill_at(monkeypatch, 3, True, lambda: train(tmp_path / "broken"))  # the last weights without a checkpoint
    train(tmp_path / "broken")
    whole, broken = (tmp_path / name / "cae.safetensors" for name in ("whole", "broken"))
    assert file_hash(broken) == file_hash(whole)
    _, metadata = load_autoencoder(whole)
    assert (metadata["step"], metadata["data_hash"], metadata["training"]["max_images"]) == (2, "00" * 32, 8)
    assert "device" not in metadata["training"]


def test_every_training_takes_the_gpu_where_there_is_one(
    options: RnnOptions, unbroken: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recall = RecallOptions(
        **{name: getattr(options, name) for name in ("data", "out", "encoder", "features")}, policy=(unbroken,)
    )
    cae = CaeOptions(data=options.data, out=options.out, precision="float32")
    asked, make = [], torch.zeros

    def zeros(*args, **kwargs) -> torch.Tensor:
        if "device" in kwargs:
            asked.append(kwargs["device"])
            if kwargs["device"] == "cuda":
                raise RuntimeError("no CUDA device is free")
        return make(*args, **kwargs)

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("models.training.rnn.policy_graph", lambda *_: b"")  # the exporter asks for the GPU too
    monkeypatch.setattr(torch, "zeros", zeros)
    for train, given in ((train_cae, cae), (train_rnn, options), (train_recall, recall)):
        with pytest.raises(
            InputError, match=r"--device cuda cannot be used \(no CUDA device is free\): choose auto, or cpu"
        ):
            train(given)
    on_cpu = replace(options, device="cpu")
    assert device_of(on_cpu) == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)  # for the exporter
    assert file_hash(train_rnn(on_cpu)) == file_hash(unbroken)
    assert [device for device in asked if isinstance(device, str)] == ["cuda", "cuda", "cuda", "cpu"]


def test_weight_file_that_a_kill_left_out_is_written_at_the_next_start(options: RnnOptions, unbroken: Path) -> None:
    path = train_rnn(options)
    path.unlink()
    assert file_hash(train_rnn(options)) == file_hash(unbroken)


def test_terminated_training_says_so_and_goes_on(
    options: RnnOptions, unbroken: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_batch = RnnTraining.make_batch

    def terminated(self: RnnTraining, step: int) -> object:
        if step == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return make_batch(self, step)

    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch:
        patch.setattr(RnnTraining, "make_batch", terminated)
        with listening(), pytest.raises(Interrupted) as end:
            train_rnn(options)
    assert end.value.number == signal.SIGTERM
    assert end.value.__notes__ == [f"{options.out / 'rnn.ckpt'} keeps what was done: the same command goes on"]
    assert signal.getsignal(signal.SIGTERM) == before
    steps: list[int] = []
    monkeypatch.setattr(RnnTraining, "make_batch", lambda self, step: steps.append(step) or make_batch(self, step))
    assert file_hash(train_rnn(options)) == file_hash(unbroken)
    assert steps == [3]


def test_finished_training_is_not_taken_further_by_more_steps(options: RnnOptions) -> None:
    path = train_rnn(options)
    with pytest.raises(InputError, match=r"rnn\.ckpt was made with steps 4, not 8: give the same, or another --out"):
        train_rnn(replace(options, steps=8))
    assert not (options.out / "rnn-8.onnx").exists()
    assert load_policy(path).metadata["step"] == 4


def test_rate_falls_once_and_never_rises() -> None:
    training = Training(100, 1e-3, 1e-5)
    rates = [training.rate(step) for step in range(101)]
    assert rates[0] == pytest.approx(1e-3)
    assert rates[50] == pytest.approx(0.5 * (1e-3 + 1e-5))
    assert rates[100] == pytest.approx(1e-5)
    assert all(np.diff(rates) < 0)


def test_other_options_data_and_seeds_are_refused_with_both_values(
    options: RnnOptions, tmp_path: Path, grown_data_file: Path
) -> None:
    train_rnn(options)
    for changes, named in (
        ({"seed": 3}, "seed 0, not 3"),
        ({"learning_rate": 0.5}, "learning_rate 0.01, not 0.5"),
        (
            {"augmentation": replace(options.augmentation, joint_noise=0.5)},
            r"augmentation\.joint_noise 0\.08, not 0\.5",
        ),
        ({"data": grown_data_file, "features": tmp_path / "other.npz"}, r"data [0-9a-f]{64}, not [0-9a-f]{64}"),
    ):
        with pytest.raises(InputError, match=named):
            train_rnn(replace(options, **changes))
    train_rnn(replace(options, checkpoint_every=1, validate_every=1))  # these change no weight


@pytest.mark.parametrize("what", ["loss", "weight"])
def test_what_is_not_finite_stops_and_keeps_the_last_checkpoint(
    options: RnnOptions, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    loss = RnnTraining.loss

    def diverging(self: RnnTraining, data: object, step: int) -> object:
        found, figures = loss(self, data, step)
        if step == 3 and what == "weight":
            with torch.no_grad():
                self.rnn.output.bias[0] = float("inf")
        return (found * float("nan") if step == 3 and what == "loss" else found), figures

    monkeypatch.setattr(RnnTraining, "loss", diverging)
    words = {"loss": "the loss of update 4 is nan", "weight": "a weight is not finite after update 4"}[what]
    with pytest.raises(InputError, match=rf"{words}; .*rnn\.ckpt keeps update 2: .*lower --learning-rate"):
        train_rnn(options)
    stored = torch.load(options.out / "rnn.ckpt", weights_only=True)
    assert stored["done"] == 2
    assert all(value.isfinite().all() for value in stored["state"].values())
    assert not (options.out / "rnn-4.onnx").exists()


@pytest.mark.parametrize("damage", ["empty", "cut", "foreign", "text", "protocol"])
def test_damaged_checkpoint_is_named_and_kept(options: RnnOptions, damage: str, recwarn) -> None:
    train_rnn(options)
    checkpoint = options.out / "rnn.ckpt"
    whole = checkpoint.read_bytes()
    content = {"empty": b"", "cut": whole[: len(whole) // 2], "text": b"not a checkpoint", "foreign": b""}
    content["protocol"] = whole.replace(b"\x80\x02}", b"\x80\x80\xff", 1)  # of pickle; torch warns of the first byte
    checkpoint.write_bytes(content[damage])
    if damage == "foreign":
        torch.save({"state_dict": {}, "pytorch-lightning_version": "2.5"}, checkpoint)
    left = checkpoint.read_bytes()
    recwarn.clear()
    with pytest.raises(InputError, match=r"rnn\.ckpt: not a whole checkpoint .*delete it to train from the start"):
        train_rnn(options)
    assert checkpoint.read_bytes() == left
    assert not [warning for warning in recwarn if "pickle" in str(warning.message)]


def test_checkpoint_of_another_network_of_that_name_is_named(options: RnnOptions) -> None:
    train_rnn(options)
    checkpoint = options.out / "rnn.ckpt"
    stored = torch.load(checkpoint, weights_only=True)
    stored["state"]["rnn.hidden.weight"] = torch.zeros(2, 2)
    torch.save(stored, checkpoint)
    with pytest.raises(InputError, match=r"rnn\.ckpt: does not fit the network .*rnn\.hidden\.weight"):
        train_rnn(options)


def ended(*arguments: object, before: str = "") -> subprocess.CompletedProcess[str]:
    """`python -m models.training ARGUMENTS`, after the statements `before`."""
    code = f"{before}\nimport runpy\nrunpy.run_module('models.training', run_name='__main__', alter_sys=True)"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path) -> None:
    missing = ended("cae", "--data", tmp_path / "none.h5", "--out", tmp_path)
    assert (missing.returncode, missing.stderr.count("\n")) == (2, 1)
    assert "none.h5: the data set does not exist" in missing.stderr


def test_out_that_is_no_folder_is_bad_input(data_file: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file cannot be made \(File exists\): choose another --out"):
        main(parse(["cae", "--data", str(data_file), "--out", str(tmp_path / "file")]))


def test_without_the_extra_train_one_line_says_how_to_get_it(tmp_path: Path) -> None:
    result = ended("cae", "--data", "d.h5", "--out", tmp_path, before="import sys; sys.modules['h5py'] = None")
    assert (result.returncode, result.stderr) == (2, "error: this needs h5py: pip install -e '.[train]'\n")
