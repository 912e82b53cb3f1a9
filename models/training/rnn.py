"""Training of the recurrent network (Eq. 2)."""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import torch
import tyro
from torch import Tensor

from models.data.augmentation import Augmentation
from models.data.demonstrations import Demonstration, content_of, read_both_splits, read_header, subtask_ranges
from models.data.scaling import MinMaxScaling
from models.data.sequences import Batch, SequencePack, errors, make_batch, pack_sequences, run
from models.errors import InputError
from models.files.container import WeightsError, file_hash
from models.files.weights import StoredPolicy, load_policy, save_policy
from models.inference import Encoder
from models.networks import NETWORKS
from models.networks.onnx_export import policy_graph
from models.networks.rnn import make_rnn, network_class
from models.training.features import encode_dataset
from models.training.metrics import validate
from models.training.trainer import Training, TrainingOptions, fit, prepare, step_generator

JOINTS = 7
POOL = 256  # states that later sequences may start from


@dataclass(kw_only=True)
class RnnOptions(TrainingOptions):
    """Trains a recurrent network on the features and postures of the training demonstrations.

    Args:
        encoder: file of `training export`; the data set is encoded once.
        features: file in which the features are kept for other trainings; DIR/features.npz if not given.
        rnn: network: a name, or package.module:Class for a subclass of models.networks.rnn.RecurrentNetwork.
        start_from: candidate file whose weights and scaling are trained further, on this encoder's features; of the
            same network and initial posture.
        steps: updates; the network's own number (training_defaults) if not given.
        batch_size: sequences an update; a sequence is one subtask.
        posture_weight: weight of the posture's squared errors in Eq. 2, 1 in the paper; the network's own if not given.
        carry_over: share of sequences that start from a late state of an earlier one instead of c_0.
        target: command to learn: the action at k, or the posture measured at k+1, which holds what the teacher's arm
            was pushed off by.
        scaling_margin: how much wider than the data the scaling's bounds are.
        least_half_range: rad; a joint that moves less is scaled as if it moved that far, so that the noise on it, and
            what counts as an error of it, is not much smaller than that of the others.
        learning_rate: of Adam, decays to final_rate by a cosine; the network's own if not given.
        final_rate: see learning_rate.
        checkpoint_every: updates between checkpoints, each with a candidate file rnn-STEP.onnx.
        validate_every: updates between validations.
        augmentation: of the inputs.
    """

    encoder: Path
    features: Path | None = None
    rnn: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(NETWORKS) + ",package.module:Class}")] = "lstm"
    start_from: Path | None = None
    steps: int | None = None
    batch_size: int = 16
    posture_weight: float | None = None
    carry_over: float = 0.5
    target: Literal["posture", "action"] = "action"
    scaling_margin: float = 1.1
    least_half_range: float = 0.3
    learning_rate: float | None = None
    final_rate: float = 1e-4
    checkpoint_every: int = 2_000
    validate_every: int = 500
    augmentation: Augmentation = field(default_factory=Augmentation)

    def with_defaults(self) -> Self:
        """With the network's own values where none are given; raises InputError for a network that there is not."""
        own = network_class(self.rnn).training_defaults
        return replace(self, **{name: value for name, value in own.items() if getattr(self, name) is None})


def posture_scaling(demos: list[Demonstration], margin: float, least_half_range: float) -> MinMaxScaling:
    """Bounds (8,) that hold the postures; raises InputError without a demonstration."""
    if not demos:
        raise InputError("the split train has no demonstration: teach more (diagrams/teach.py with a larger --limit)")
    rows = np.concatenate([demo.posture for demo in demos])
    least = np.full(rows.shape[1], 0.01)
    least[:JOINTS] = least_half_range
    return MinMaxScaling.from_data(rows, margin, least)


class SequenceTraining(Training):
    """A training on batches of sequences, some of which start from a late state of an earlier one."""

    pool: Tensor

    def __init__(self, options: Any, carry_over: float, train: SequencePack, policy: Any) -> None:
        super().__init__(options.steps, options.learning_rate, options.final_rate)
        self.options, self.carry_over, self.train_pack = options, carry_over, train
        self.policy, self.rnn = policy, policy.rnn
        # Late states of earlier sequences; row 0 stays c_0.
        self.register_buffer("pool", self.rnn.initial_state(POOL).clone())

    def make_batch(self, step: int) -> tuple[Batch, Tensor, Tensor]:
        """Sequences with their augmentation, the rows of the pool they start from, and the rows they end in."""
        size, generator = self.options.batch_size, step_generator(self.options.seed, step)
        index = torch.randint(0, len(self.train_pack.length), (size,), generator=generator)
        batch = make_batch(self.train_pack.pick(index), JOINTS, self.options.augmentation, generator)
        carried = torch.rand(size, generator=generator) < self.carry_over
        start = torch.randint(0, POOL, (size,), generator=generator) * carried
        end = 1 + (step * size + torch.arange(size)) % (POOL - 1)
        return batch.to(self.pool.device), start, end

    def run(self, data: tuple[Batch, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """y (T, B, 38) and states (T, B, S) from the pool's states; keeps the states for later sequences."""
        batch, start, end = data
        y, states = run(self.rnn, batch, self.pool[start])
        self.pool[end] = states[batch.carry, torch.arange(states.shape[1])].detach()
        return y, states


class RnnTraining(SequenceTraining):
    """The recurrent network under training."""

    def __init__(self, options: RnnOptions, train: SequencePack, valid: SequencePack, policy: StoredPolicy) -> None:
        super().__init__(options, options.carry_over, train, policy)
        self.valid_pack = valid

    def loss(self, data: Any, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. 2 over the batch, by its number of ticks and of outputs, so that the learning rate fits any."""
        batch = data[0]
        y, states = self.run(data)
        valid = batch.valid[: len(y), :, None]
        posture, feature = ((valid * part).sum() for part in errors(y, batch))
        state = states[batch.last, torch.arange(states.shape[1])].square().sum()
        loss = (self.options.posture_weight * posture + feature + state) / (valid.sum() * y.shape[-1])
        return loss, {"loss": loss, "posture": posture, "feature": feature, "state": state}

    def validate(self, done: int) -> dict[str, float]:
        if done % self.options.validate_every and done != self.steps:
            return {}
        return validate(self.rnn, self.valid_pack, JOINTS)

    def weight_file(self, done: int) -> Path:
        """A candidate a checkpoint."""
        return self.options.out / f"rnn-{done}.onnx"

    def export(self, path: Path, done: int) -> None:
        self.policy.metadata["step"] = done
        save_policy(path, self.policy)


def prepare_sequences(
    options: Any, demos: list[Demonstration], encoder: Any, scaling: MinMaxScaling, target: str
) -> dict[str, SequencePack]:
    """Sequences of each split ("train", "valid"), with room for the rest after their end."""
    # What cannot be used is refused before the pictures are encoded.
    shortest = min(last - first for demo in demos for first, last in subtask_ranges(demo))
    if (most := options.augmentation.carry_ticks) > shortest:
        raise InputError(
            f"--augmentation.carry-ticks {most} is more than the {shortest} ticks of the shortest subtask in "
            f"{options.data}: choose at most that"
        )
    features = encode_dataset(options.data, encoder, options.features or options.out / "features.npz")
    return {
        split: pack_sequences(
            [demo for demo in demos if demo.split == split], features, scaling, target, options.augmentation.rest_ticks
        )
        for split in ("train", "valid")
    }


def load_start(path: Path, options: RnnOptions, initial: np.ndarray, feature_size: int) -> StoredPolicy:
    """The candidate to train further; raises WeightsError where it was made for something else."""
    started = load_policy(path)
    for what, have, want in (
        ("network", started.rnn.spec, options.rnn),
        ("initial posture", started.initial_posture.round(6).tolist(), initial.round(6).tolist()),
        ("feature size", started.rnn.feature_size, feature_size),
    ):
        if have != want:
            raise WeightsError(path, f"has the {what} {have}, not {want}", "Give a candidate of that one")
    return started


def train_rnn(options: RnnOptions) -> Path:
    """Runs the training and returns the path of the last candidate."""
    options = options.with_defaults()
    prepare(options)
    header, encoder, demos = read_header(options.data), Encoder(options.encoder), read_both_splits(options.data)
    initial = header.initial_posture
    metadata: dict[str, Any] = {
        "training": options.as_metadata(),
        "data_hash": header.content_hash,
        "world": header.world,
    }
    made_from = {"data": content_of(options.data), "encoder": encoder.hash}
    rnn = make_rnn(options.rnn, len(initial), encoder.feature_size)
    if options.start_from is None:
        train = [demo for demo in demos if demo.split == "train"]
        scaling = posture_scaling(train, options.scaling_margin, options.least_half_range)
    else:
        started = load_start(options.start_from, options, initial, encoder.feature_size)
        made_from["start_from"] = file_hash(options.start_from)
        if started.encoder_hash != encoder.hash:
            print(
                f"warning: {options.start_from} was trained with another encoder than {options.encoder}: it learns to "
                "read this one's features",
                file=sys.stderr,
            )
        ancestor = {"hash": made_from["start_from"], "encoder_hash": started.encoder_hash}
        metadata["started_from"] = ancestor | started.metadata
        scaling = started.scaling
        rnn.load_state_dict(started.rnn.state_dict())
    packs = prepare_sequences(options, demos, encoder, scaling, options.target)
    length = packs["train"].length
    print(
        f"{len(length)} training and {len(packs['valid'].length)} validation sequences of "
        f"{int(length.min())} to {int(length.max())} ticks"
    )
    policy = StoredPolicy(
        rnn=rnn, name=rnn.name, scaling=scaling, initial_posture=initial,
        encoder_hash=encoder.hash, metadata=metadata,
    )  # fmt: skip
    policy_graph(rnn, None)  # a network that cannot be exported is refused before it is trained
    training = RnnTraining(options, packs["train"], packs["valid"], policy)
    fit(training, options, made_from, name="rnn", clip=1.0)
    return training.weight_file(training.steps)
