"""Training of the recurrent network (Eq. 2) with the regulator's pull in its output (Eq. 3, alpha = 0)."""

from __future__ import annotations

import os
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from models.data.demonstrations import DatasetHeader, Demonstration, iterate_frames, read_demonstrations, read_header
from models.data.scaling import MinMaxScaling
from models.data.sequences import Augmentation, SequencePack, errors, make_batch, pack_sequences, run
from models.files.weights import StoredPolicy, WeightsError, file_hash, load_policy, save_policy
from models.inference import Encoder
from models.networks.rnn import make_rnn
from models.training.trainer import StepModule, TrainingOptions, fit, prepare, step_generator
from models.training.validation import validate

JOINTS = 7
# The MTRNN has a twentieth of the LSTM's weights: it spends them on the features unless the posture weighs more. At 1e-2 it diverges.
NEEDS: dict[str, dict[str, Any]] = {
    "lstm": {"steps": 10_000, "posture_weight": 4.0, "learning_rate": 1e-3},
    "gru": {"steps": 10_000, "posture_weight": 4.0, "learning_rate": 1e-3},
    "mtrnn": {"steps": 16_000, "posture_weight": 40.0, "learning_rate": 4e-3},
}


@dataclass(kw_only=True)
class RnnOptions(TrainingOptions):
    """Trains a recurrent network on the features and postures of the training demonstrations.

    Args:
        encoder: autoencoder file; the data set is encoded once.
        features: file in which the features are kept for other trainings; DIR/features.npz if not given.
        rnn: network of Table I.
        start_from: candidate file whose weights and scaling are trained further, on this encoder's features; of the same network,
            regulator gain and initial posture.
        steps: updates; None: as the network needs, see NEEDS.
        batch_size: sequences an update; a sequence is one subtask.
        posture_weight: weight of the posture's against the features' mean square error; None: see NEEDS.
        start_weight: extra weight of the first start_ticks ticks, where the network must start by itself.
        start_ticks: see start_weight.
        state_weight: weight of the mean of (c_0 - c_T)^2.
        carry_over: share of sequences that start from a late state of an earlier one instead of c_0.
        regulator_gain: K a tick, as the regulator of the diagram.
        target: command to learn: the action at k, or the posture measured at k+1, which has what the teacher's arm was pushed off by.
        scaling_margin: how much wider than the data the scaling's bounds are.
        least_half_range: rad; a joint that moves less is scaled as if it moved that far, so that the noise on it, and
            what counts as an error of it, is not much smaller than that of the others.
        learning_rate: of Adam, decays to final_rate by a cosine; None: see NEEDS.
        final_rate: see learning_rate.
        checkpoint_every: updates between checkpoints, each with a candidate file rnn-STEP.safetensors.
        validate_every: updates between validations.
        augmentation: of the inputs.
    """

    encoder: Path
    features: Path | None = None
    rnn: Literal["lstm", "gru", "mtrnn"] = "lstm"
    start_from: Path | None = None
    steps: int | None = None
    batch_size: int = 16
    posture_weight: float | None = None
    start_weight: float = 3.0
    start_ticks: int = 6
    state_weight: float = 1.0
    carry_over: float = 0.5
    regulator_gain: float = 0.1
    target: Literal["posture", "action"] = "action"
    scaling_margin: float = 1.1
    least_half_range: float = 0.3
    learning_rate: float | None = None
    final_rate: float = 1e-4
    checkpoint_every: int = 2_000
    validate_every: int = 500
    augmentation: Augmentation = field(default_factory=Augmentation)
    accelerator: str = "cpu"  # a tick at a time on 16 sequences is no work for a GPU: its launches alone take longer

    def __post_init__(self) -> None:
        for name, value in NEEDS.get(self.rnn, NEEDS["lstm"]).items():
            if getattr(self, name) is None:
                setattr(self, name, value)


def encode_dataset(path: Path, encoder: Encoder, cache: Path, content_hash: str) -> dict[str, np.ndarray]:
    """Features (T, 30) of every demonstration by name; from the cache if encoder and data are the same."""
    key = f"{encoder.hash} {content_hash}"
    if cache.is_file():
        with np.load(cache) as stored:
            if str(stored["key"]) == key:
                return {name: stored[name] for name in stored.files if name != "key"}
    names = [demo.name for demo in read_demonstrations(path)]
    features = {}
    for name, rgb in zip(names, iterate_frames(path, names), strict=True):
        features[name] = encoder.encode_batch(rgb)
        print(f"\rencoding {len(features)}/{len(names)}", end="", flush=True)
    print()
    cache.parent.mkdir(parents=True, exist_ok=True)
    partial = cache.with_name(f"{cache.stem}.{os.getpid()}.npz")
    np.savez(partial, allow_pickle=False, key=np.array(key), **features)
    partial.replace(cache)
    return features


def posture_scaling(
    demos: list[Demonstration], initial: np.ndarray, gain: float, margin: float, least_half_range: float
) -> MinMaxScaling:
    """Bounds (8,) that hold the postures and the network's output, which also makes up for the regulator's pull."""
    rows = []
    for demo in demos:
        pull = gain * (demo.posture[:-1] - initial)
        pull[:, JOINTS:] = 0.0
        rows += [demo.posture, demo.posture[1:] + pull]
    least = np.full(len(initial), 0.01)
    least[:JOINTS] = least_half_range
    return MinMaxScaling.from_data(np.concatenate(rows), margin, least)


class RnnModule(StepModule):
    """The recurrent network under training. A batch is a sequences.Batch and rows of the pool."""

    pool: Tensor

    def __init__(self, options: RnnOptions, train: SequencePack, valid: SequencePack, policy: StoredPolicy) -> None:
        assert options.steps is not None
        assert options.learning_rate is not None
        super().__init__(options.steps, options.learning_rate, options.final_rate)
        self.options, self.train_pack, self.valid_pack, self.policy = options, train, valid, policy
        self.rnn = policy.rnn
        initial = policy.scaling.scale(policy.initial_posture)
        self.initial = torch.from_numpy(initial).float()
        # Late states of earlier sequences; row 0 stays c_0.
        self.register_buffer("pool", torch.zeros(256, self.rnn.state_size))

    def make_batch(self, step: int) -> Any:
        """Sequences with their augmentation, the rows of the pool they start from, and the rows they end in."""
        options = self.options
        generator = step_generator(options.seed, step)
        size = options.batch_size
        index = torch.randint(0, len(self.train_pack.length), (size,), generator=generator)
        batch = make_batch(self.train_pack.pick(index), self.initial, JOINTS, options.augmentation, generator)
        carried = torch.rand(size, generator=generator) < options.carry_over
        start = torch.randint(0, len(self.pool), (size,), generator=generator) * carried
        end = 1 + (step * size + torch.arange(size)) % (len(self.pool) - 1)
        return batch, start, end

    def training_step(self, data: Any, _: int) -> Tensor:
        """Eq. 2."""
        options = self.options
        batch, start, end = data
        y, states = run(self.rnn, batch, self.pool[start])
        posture, feature = (part.mean(-1) for part in errors(y, batch, options.regulator_gain))
        weight = batch.valid[: len(y)].clone()
        early = weight[: options.start_ticks].sum() * options.start_weight
        weight[: options.start_ticks] *= 1.0 + options.start_weight
        posture_loss = (weight * posture).sum() / (weight.sum() - early)
        feature_loss = (batch.valid[: len(y)] * feature).sum() / batch.valid.sum()
        final = states[batch.last, torch.arange(states.shape[1])]
        state_loss = final.square().mean()
        self.pool[end] = states[batch.carry, torch.arange(states.shape[1])].detach()
        loss = options.posture_weight * posture_loss + feature_loss + options.state_weight * state_loss
        self.log("loss", loss.detach(), prog_bar=True)
        self.log("posture", posture_loss.detach(), prog_bar=True)
        self.log("feature", feature_loss.detach(), prog_bar=True)
        self.log("state", state_loss.detach(), prog_bar=True)
        done = self.trainer.global_step + 1
        if done % options.validate_every == 0 or done == self.steps:
            on_cpu = deepcopy(self.rnn).cpu()  # where its sequences are
            result = validate(on_cpu, self.valid_pack, self.initial, options.regulator_gain, JOINTS)
            self.log_dict({f"valid_{name}": value for name, value in result.items()})
            self.print(f"\nupdate {done}: " + ", ".join(f"{name} {value:.4f}" for name, value in result.items()))
        return loss

    def export(self, step: int, final: bool) -> None:
        """Writes the candidate of this update."""
        self.policy.metadata["step"] = step
        save_policy(self.options.out / f"rnn-{step}.safetensors", self.policy)


def prepare_sequences(
    options: Any,
    encoder: Encoder,
    scaling: MinMaxScaling | None,
    initial: np.ndarray,
    gain: float,
    target: str,
    content_hash: str,
) -> tuple[SequencePack, SequencePack, MinMaxScaling]:
    """Training and validation sequences, and the scaling (made from the training data if None is given)."""
    features = encode_dataset(options.data, encoder, options.features or options.out / "features.npz", content_hash)
    train, valid = (read_demonstrations(options.data, split) for split in ("train", "valid"))
    if scaling is None:
        scaling = posture_scaling(train, initial, gain, options.scaling_margin, options.least_half_range)
    rest = options.augmentation.rest_ticks
    packs = [pack_sequences(demos, features, scaling, target, rest) for demos in (train, valid)]
    return packs[0], packs[1], scaling


def load_start(path: Path, options: RnnOptions, header: DatasetHeader) -> StoredPolicy:
    """The candidate to train further; raises WeightsError where its weights or its scaling were made for something else."""
    started = load_policy(path)
    for what, have, want in (
        ("network", started.rnn.name, options.rnn),
        ("regulator gain", started.regulator_gain, options.regulator_gain),
        ("initial posture", started.initial_posture.round(6).tolist(), header.initial_posture.round(6).tolist()),
    ):
        if have != want:
            raise WeightsError(path, f"has the {what} {have}, not {want}", "Give a candidate of that one")
    return started


def train_rnn(options: RnnOptions) -> Path:
    """Runs the training and returns the path of the last candidate."""
    prepare(options)
    header, encoder = read_header(options.data), Encoder(options.encoder)
    metadata: dict[str, Any] = {"training": options.as_metadata(), "data_hash": header.content_hash}
    started = None
    if options.start_from is not None:
        started = load_start(options.start_from, options, header)
        ancestor = {"hash": file_hash(options.start_from), "encoder_hash": started.encoder_hash}
        metadata["started_from"] = ancestor | started.metadata
    train, valid, scaling = prepare_sequences(
        options,
        encoder,
        None if started is None else started.scaling,
        header.initial_posture,
        options.regulator_gain,
        options.target,
        header.content_hash,
    )
    rnn = make_rnn(options.rnn, len(header.initial_posture), encoder.feature_size)
    if started is not None:
        rnn.load_state_dict(started.rnn.state_dict())
    policy = StoredPolicy(
        rnn,
        None,
        scaling,
        header.initial_posture,
        options.regulator_gain,
        encoder.hash,
        metadata=metadata,
    )
    print(
        f"{len(train.length)} training and {len(valid.length)} validation sequences of "
        f"{int(train.length.min())} to {int(train.length.max())} ticks"
    )
    fit(RnnModule(options, train, valid, policy), options, options.checkpoint_every, clip=1.0)
    return options.out / f"rnn-{options.steps}.safetensors"
