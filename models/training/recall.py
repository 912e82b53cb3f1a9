"""Training of the recall heads (Eq. 4) on the states of a finished network, all of whose weights stay."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models.data.demonstrations import read_header
from models.data.sequences import Augmentation, SequencePack, make_batch, run
from models.files.weights import StoredPolicy, WeightsError, load_policy, save_policy
from models.inference import Encoder
from models.networks.recall import RecallHeads
from models.training.rnn import JOINTS, prepare_sequences
from models.training.trainer import StepModule, TrainingOptions, fit, prepare, step_generator


@dataclass(kw_only=True)
class RecallOptions(TrainingOptions):
    """Trains recall heads for each given candidate; writes policy-STEP.safetensors, network and heads in one file.

    Args:
        policy: candidate files of `training rnn`, one or more.
        encoder: autoencoder file that the candidates were trained with.
        features: file in which `training rnn` kept the features; DIR/features.npz if not given.
        horizon: N, ticks recalled.
        hidden: units of the hidden layer; 0 gives the paper's linear heads.
        steps: updates.
        batch_size: sequences an update.
        learning_rate: of Adam, decays to final_rate by a cosine.
        final_rate: see learning_rate.
        checkpoint_every: updates between checkpoints.
        augmentation: of the inputs, as in the network's training, but with more and longer standstills before the loop is closed: to
            recall the way that should have been gone is what gives a stopped arm away.
    """

    policy: tuple[Path, ...]
    encoder: Path
    features: Path | None = None
    horizon: int = 10
    hidden: int = 256
    steps: int = 2_000
    batch_size: int = 16
    learning_rate: float = 2e-3
    final_rate: float = 2e-5
    checkpoint_every: int = 500
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(loop_probability=0.6, hold_probability=1.0))
    accelerator: str = "cpu"  # a tick at a time on 16 sequences is no work for a GPU: its launches alone take longer


def recall_targets(clean: Tensor, horizon: int) -> Tensor:
    """Clean m_{k-n}, n = 1..N, of postures (T, B, 8): (T, B, N, 8); before the start the sequence's first posture."""
    k = torch.arange(len(clean))[:, None]
    past = (k - torch.arange(1, horizon + 1)).clamp_min(0)
    return clean[past].transpose(1, 2)


class RecallModule(StepModule):
    """Recall heads under training. The network takes no gradient and never changes."""

    pool: Tensor

    def __init__(self, options: RecallOptions, train: SequencePack, policy: StoredPolicy, out: Path) -> None:
        super().__init__(options.steps, options.learning_rate, options.final_rate)
        self.options, self.pack, self.policy, self.out = options, train, policy, out
        # Not in eval mode, of which Lightning would warn; no layer of it differs there.
        self.rnn = rnn = policy.rnn.train().requires_grad_(False)
        self.heads = RecallHeads(rnn.state_size, rnn.posture_size, options.horizon, options.hidden or None)
        self.initial = torch.from_numpy(policy.scaling.scale(policy.initial_posture)).float()
        self.register_buffer("pool", torch.zeros(256, rnn.state_size))

    def make_batch(self, step: int) -> Any:
        """As in the network's training: half of the sequences start from a late state of an earlier one."""
        options, generator = self.options, step_generator(self.options.seed, step)
        index = torch.randint(0, len(self.pack.length), (options.batch_size,), generator=generator)
        batch = make_batch(self.pack.pick(index), self.initial, JOINTS, options.augmentation, generator)
        carried = torch.rand(options.batch_size, generator=generator) < 0.5
        start = torch.randint(0, len(self.pool), (options.batch_size,), generator=generator) * carried
        end = 1 + (step * options.batch_size + torch.arange(options.batch_size)) % (len(self.pool) - 1)
        return batch, start, end

    def training_step(self, data: Any, _: int) -> Tensor:
        """Eq. 4 on every valid tick, and on c_0, which recalls the first posture."""
        batch, start, end = data
        with torch.no_grad():
            states = run(self.rnn, batch, self.pool[start])[1]
            self.pool[end] = states[batch.carry, torch.arange(states.shape[1])]
        valid = batch.valid[: len(states)] > 0
        target = recall_targets(batch.clean[: len(states)], self.options.horizon)
        loss = (self.heads(states[valid]) - target[valid]).square().mean()
        first = self.heads(self.rnn.initial_state(1)) - self.initial.to(self.device)
        self.log("loss", loss.detach(), prog_bar=True)
        self.log("rms", loss.detach().sqrt(), prog_bar=True)
        return loss + 0.01 * first.square().mean()

    def export(self, step: int, final: bool) -> None:
        """Writes the policy file once the heads are done."""
        if final:
            self.policy.recall = self.heads
            save_policy(self.out, self.policy)


@torch.inference_mode()
def recall_errors(policy: StoredPolicy, pack: SequencePack) -> Tensor:
    """Mean squared scaled error of the joints (N,) for n = 1..N on clean sequences, inputs from the data."""
    assert policy.recall is not None
    initial = torch.from_numpy(policy.scaling.scale(policy.initial_posture)).float()
    batch = make_batch(pack, initial, JOINTS, None, torch.Generator())
    _, states = run(policy.rnn, batch, policy.rnn.initial_state(len(pack.length)))
    valid = batch.valid[: len(states)] > 0
    target = recall_targets(batch.clean[: len(states)], policy.recall.horizon)
    error = policy.recall(states[valid]) - target[valid]
    return error[..., :JOINTS].square().mean((0, 2))


def train_recall(options: RecallOptions) -> list[Path]:
    """Trains heads for each candidate in turn; skips those whose policy file is there. Returns the policy files."""
    prepare(options)
    encoder, content_hash = Encoder(options.encoder), read_header(options.data).content_hash
    written = []
    for path in options.policy:
        policy = load_policy(path)
        if policy.encoder_hash != encoder.hash:
            raise WeightsError(path, f"was trained with another autoencoder than {options.encoder}", "Give that one")
        out = options.out / ("policy-" + path.stem.removeprefix("rnn-") + ".safetensors")
        written.append(out)
        if out.is_file():
            print(f"{out} is there already")
            continue
        prepare(options)  # the same heads for a candidate whether others came before it or not
        target = policy.metadata.get("training", {}).get("target", "posture")
        train, valid, _ = prepare_sequences(
            options, encoder, policy.scaling, policy.initial_posture, policy.regulator_gain, target, content_hash
        )
        policy.metadata["recall_training"] = options.as_metadata()
        fit(RecallModule(options, train, policy, out), options, options.checkpoint_every, name=out.stem)
        rms = recall_errors(policy, valid).sqrt().tolist()
        print(
            f"{out}: rms recall error of the joints on validation, scaled, n = 1..{len(rms)}: "
            + " ".join(f"{value:.4f}" for value in rms)
        )
    return written
