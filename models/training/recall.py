"""Training of the recall heads (Eq. 4) on the states of a finished network, all of whose weights stay."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models.data.augmentation import Augmentation
from models.data.demonstrations import Demonstration, content_of, read_both_splits
from models.data.sequences import SequencePack, make_batch, run
from models.errors import InputError
from models.files.container import WeightsError, file_hash
from models.files.weights import StoredPolicy, load_policy, save_policy
from models.inference import Encoder, recall_file
from models.networks.recall import RecallHeads
from models.policy import make_policy
from models.training.checkpoint import refuse_other
from models.training.own import OwnEncoder, OwnStates
from models.training.rnn import JOINTS, SequenceTraining, prepare_sequences
from models.training.trainer import TrainingOptions, fit, prepare

LONGEST = 100  # ticks recalled; a subtask has from 117


@dataclass(kw_only=True)
class RecallOptions(TrainingOptions):
    """Trains recall heads for each given candidate; writes policy-STEP.onnx, network and heads in one file.

    Args:
        policy: candidate files of `training rnn`, one or more; or package.module:Class of a policy of one's own with a
            hidden state (models/policy.py), whose heads are written to NAME-recall.onnx.
        encoder: the file that the candidates were trained with.
        features: file in which `training rnn` kept the features; DIR/features.npz if not given.
        horizon: N, ticks recalled.
        hidden: units of the hidden layer; 0 gives the paper's linear heads.
        steps: updates.
        batch_size: sequences an update.
        learning_rate: of Adam, decays to final_rate by a cosine.
        final_rate: see learning_rate.
        checkpoint_every: updates between checkpoints.
        augmentation: of the inputs, as in the network's training.
    """

    policy: tuple[str, ...]
    encoder: Path
    features: Path | None = None
    horizon: int = 10
    hidden: int = 256
    steps: int = 2_000
    batch_size: int = 16
    learning_rate: float = 2e-3
    final_rate: float = 2e-5
    checkpoint_every: int = 500
    augmentation: Augmentation = field(default_factory=Augmentation)


def recall_targets(clean: Tensor, horizon: int) -> Tensor:
    """Clean m_{k-n}, n = 1..N, of postures (T, B, 8): (T, B, N, 8); before the start the sequence's first posture."""
    k = torch.arange(len(clean))[:, None]
    past = (k - torch.arange(1, horizon + 1)).clamp_min(0)
    return clean[past].transpose(1, 2)


class RecallTraining(SequenceTraining):
    """Recall heads under training. The network takes no gradient and never changes."""

    def __init__(
        self, options: RecallOptions, train: SequencePack, policy: StoredPolicy | OwnStates, out: Path
    ) -> None:
        super().__init__(options, 0.5, train, policy)
        self.rnn.requires_grad_(False)
        self.heads = RecallHeads(self.rnn.state_size, self.rnn.posture_size, options.horizon, options.hidden or None)
        self.out = out
        self.initial = torch.from_numpy(policy.scaling.scale(policy.initial_posture)).float()

    def loss(self, data: Any, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. 4 on every valid tick, and on c_0, which recalls the first posture."""
        batch = data[0]
        with torch.no_grad():
            states = self.run(data)[1]
        valid = batch.valid[: len(states)] > 0
        target = recall_targets(batch.clean[: len(states)], self.options.horizon)
        loss = (self.heads(states[valid]) - target[valid]).square().mean()
        first = self.heads(self.rnn.initial_state(1)) - self.initial.to(self.pool.device)
        return loss + 0.01 * first.square().mean(), {"loss": loss, "rms": loss.sqrt()}

    def weight_file(self, done: int) -> Path | None:
        """The policy file once the heads are done."""
        return self.out if done == self.steps else None

    def export(self, path: Path, done: int) -> None:
        self.policy.recall = self.heads
        self.policy.save(path) if isinstance(self.policy, OwnStates) else save_policy(path, self.policy)


@torch.inference_mode()
def recall_errors(policy: StoredPolicy | OwnStates, pack: SequencePack) -> Tensor:
    """Mean squared scaled error of the joints (N,) for n = 1..N on clean sequences, inputs from the data."""
    assert policy.recall is not None
    batch = make_batch(pack, JOINTS, None, torch.Generator()).to(policy.rnn.initial_state(1).device)
    _, states = run(policy.rnn, batch, policy.rnn.initial_state(len(pack.length)))
    valid = batch.valid[: len(states)] > 0
    target = recall_targets(batch.clean[: len(states)], policy.recall.horizon)
    error = policy.recall(states[valid]) - target[valid]
    return error[..., :JOINTS].square().mean((0, 2))


def train_recall(options: RecallOptions) -> list[Path]:
    """Trains heads for each candidate in turn; skips those whose policy file is there. Returns the policy files."""
    if options.horizon > LONGEST:
        raise InputError(f"--horizon {options.horizon} is too long: choose at most {LONGEST} ticks")
    files = [given for given in options.policy if ":" not in str(given)]
    outs = [_out_of(options, given) for given in files]
    if twice := [given for given, out in zip(files, outs, strict=True) if outs.count(out) > 1]:
        raise InputError(f"--policy {' '.join(twice)} would be written to one file: give each with an --out of its own")
    encoder, demos = Encoder(options.encoder), read_both_splits(options.data)
    written = []
    for given in options.policy:
        path = Path(given)
        prepare(options)  # the same heads for a candidate whether others came before it or not
        if ":" in str(given) and not path.exists():
            written.append(train_own(options, str(given), encoder, demos))
            continue
        policy = load_policy(path)
        if policy.encoder_hash != encoder.hash:
            raise WeightsError(path, f"was trained with another encoder than {options.encoder}", "Give that one")
        out = _out_of(options, given)
        written.append(out)
        if out.is_file():
            _check_done(out, options, path, policy)
            print(f"{out} is there already")
            continue
        target = policy.metadata.get("training", {}).get("target", "posture")
        packs = prepare_sequences(options, demos, encoder, policy.scaling, target)
        made_from = {"data": content_of(options.data), "policy": file_hash(path)}
        policy.metadata["recall_training"] = options.as_metadata() | {"data": made_from["data"]}
        fit(RecallTraining(options, packs["train"], policy, out), options, made_from, name=out.stem)
        say_errors(out, policy, packs["valid"])
    return written


def _out_of(options: RecallOptions, given: str) -> Path:
    """The file that is written for a candidate."""
    return options.out / ("policy-" + Path(given).stem.removeprefix("rnn-") + ".onnx")


def say_errors(out: Path, policy: Any, valid: SequencePack) -> None:
    """Prints how well the heads recall."""
    rms = recall_errors(policy, valid).sqrt().tolist()
    print(
        f"{out}: rms recall error of the joints on validation, scaled, n = 1..{len(rms)}: "
        + " ".join(f"{value:.4f}" for value in rms)
    )


def train_own(options: RecallOptions, spec: str, encoder: Encoder, demos: list[Demonstration]) -> Path:
    """Trains heads on the states of the policy that `spec` names, stepped over the same sequences; returns their file.

    Raises InputError as `make_policy` does, and for a policy without a state, or one that looks at the picture itself.
    """
    policy = OwnStates(make_policy(spec))
    out = recall_file(options.out, policy.name)
    if out.is_file():
        raise InputError(f"{out} is there already: delete it, or give another --out")
    own = policy.rnn.policy
    images = OwnEncoder(own) if hasattr(own, "encode") else encoder
    if policy.encoder_hash not in (None, encoder.hash):
        raise WeightsError(spec, f"was trained with another encoder than {options.encoder}", "Give that one")
    packs = prepare_sequences(options, demos, images, policy.scaling, "action")
    made_from = {"data": content_of(options.data), "policy": policy.hash}
    fit(RecallTraining(options, packs["train"], policy, out), options, made_from, name=out.stem)
    say_errors(out, policy, packs["valid"])
    return out


def _check_done(out: Path, options: RecallOptions, path: Path, candidate: StoredPolicy) -> None:
    """Raises InputError where `out` holds another network, or heads of other options or data."""
    done = load_policy(out)
    now = options.as_metadata() | {"data": content_of(options.data)}
    refuse_other(out, done.metadata.get("recall_training", {}), now)
    a, b = done.rnn.state_dict(), candidate.rnn.state_dict()
    if a.keys() != b.keys() or not all(torch.equal(a[name], b[name]) for name in a):
        raise InputError(f"{out} was made from another network than {path}: give another --out")
