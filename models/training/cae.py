"""Training of the autoencoder (Eq. 1, with the pixels of what moves weighted)."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import torch
from torch import Tensor

from models.checks import require_number
from models.data.demonstrations import content_of, iterate_frames, read_demonstrations, read_header
from models.files.weights import save_autoencoder
from models.networks.cae import ConvolutionalAutoencoder, to_image
from models.training.trainer import Training, TrainingOptions, device_of, fit, prepare, step_generator


@dataclass(kw_only=True)
class CaeOptions(TrainingOptions):
    """Trains the convolutional autoencoder on the pictures of the training demonstrations.

    Args:
        max_images: images shown in all; decides the training time.
        batch_size: images an update.
        foreground_weight: weight of a pixel that differs from the median picture; 1 is the paper's plain MSE.
        foreground_threshold: from that difference on, of [0, 1], in any channel.
        feature_activation: "tanh", or the paper's "relu".
        feature_noise: std of Gaussian noise on the features, which spreads them over their range.
        noise: std of Gaussian noise on the input pixels, of [0, 1].
        colour: half range of the random brightness, contrast and channel gains.
        shift: largest shift of a picture in x and y, as it goes in and as it shall come out, whole pixels: the can is
            then seen between the trained positions too.
        learning_rate: of Adam, decays to a hundredth by a cosine.
        checkpoint_every: updates between checkpoints.
        precision: of convolutions and full layers. "auto" takes bfloat16 where the processor or the GPU multiplies it,
            at about twice the speed, and float32 elsewhere; weights, sums over a batch and the loss are float32.
    """

    max_images: int = 40_000
    batch_size: int = 64
    foreground_weight: float = 16.0
    foreground_threshold: float = 0.08
    feature_activation: str = "tanh"
    feature_noise: float = 0.1
    noise: float = 0.02
    colour: float = 0.05
    shift: int = 2
    learning_rate: float = 1e-3
    checkpoint_every: int = 200
    precision: Literal["auto", "float32", "bfloat16"] = "auto"

    def with_precision(self) -> Self:
        """With the precision that "auto" stands for here: a checkpoint and a weight file state it."""
        if self.precision != "auto":
            return self
        on_gpu = device_of(self) != "cpu"
        fast = torch.cuda.is_bf16_supported() if on_gpu else torch.cpu.get_capabilities().get("avx512_bf16", False)
        return replace(self, precision="bfloat16" if fast else "float32")


def load_frames(path: Path) -> np.ndarray:
    """Pictures of the training demonstrations in memory, uint8 (n, 112, 112, 3)."""
    demos = read_demonstrations(path, "train")
    ends = np.cumsum([len(demo.posture) for demo in demos])
    frames = np.empty((ends[-1], 112, 112, 3), np.uint8)
    for end, rgb in zip(ends, iterate_frames(path, [demo.name for demo in demos]), strict=True):
        frames[end - len(rgb) : end] = rgb
    return frames


def median_image(frames: np.ndarray, samples: int = 501) -> np.ndarray:
    """Median picture (112, 112, 3), uint8, over evenly spaced frames."""
    picked = np.linspace(0, len(frames) - 1, min(samples, len(frames))).astype(int)
    return np.median(frames[picked], axis=0).astype(np.uint8)


def augment(image: Tensor, noise: float, colour: float, generator: torch.Generator) -> Tensor:
    """Images (B, 3, 112, 112) with random brightness, contrast, channel gains and Gaussian noise."""

    def uniform(*shape: int) -> Tensor:
        return colour * (2.0 * torch.rand(len(image), *shape, 1, 1, generator=generator) - 1.0).to(image.device)

    gain = (1.0 + uniform(1)) * (1.0 + 0.5 * uniform(3))
    offset = 0.5 * uniform(1)
    grain = torch.randn(image.permute(0, 2, 3, 1).shape, generator=generator).permute(0, 3, 1, 2).to(image.device)
    return (image - 0.5) * gain + (0.5 + offset) + noise * grain


def shifted(image: Tensor, mask: Tensor, most: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """(B, 3, S, S) and (B, 1, S, S), each pair moved by 0 to `most` whole pixels in x and in y; the edges repeat."""
    size, device = image.shape[-1], image.device
    by = torch.randint(-most, most + 1, (2, len(image), 1), generator=generator)
    rows, columns = (torch.arange(size) + by).clamp(0, size - 1).to(device)
    each = torch.arange(len(image), device=device)[:, None, None]

    def move(x: Tensor) -> Tensor:
        return x.permute(0, 2, 3, 1)[each, rows[:, :, None], columns[:, None, :]].permute(0, 3, 1, 2)

    return move(image), move(mask)


class CaeTraining(Training):
    """The autoencoder under training. Batches are uint8 (B, 112, 112, 3)."""

    median: Tensor

    def __init__(self, options: CaeOptions, frames: np.ndarray, metadata: dict[str, Any]) -> None:
        rate = options.learning_rate
        super().__init__(max(1, options.max_images // options.batch_size), rate, rate / 100.0)
        self.options, self.frames, self.metadata = options, torch.from_numpy(frames), metadata
        self.model = ConvolutionalAutoencoder(options.feature_activation)
        self.model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.register_buffer("median", to_image(torch.from_numpy(median_image(frames))[None]), persistent=False)

    def make_batch(self, step: int) -> Tensor:
        """Without repetition within a pass over the frames."""
        size, count = min(self.options.batch_size, len(self.frames)), len(self.frames)
        per_pass = count // size
        order = torch.randperm(count, generator=step_generator(self.options.seed, -1 - step // per_pass))
        first = step % per_pass * size
        return self.frames[order[first : first + size].sort().values]

    def loss(self, batch: Tensor, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """Eq. 1 from an augmented to the clean picture, weighted."""
        options, generator, device = self.options, step_generator(self.options.seed, step), self.median.device
        clean = to_image(batch.to(device))
        # What stands still in all pictures is most of the area and tells nothing: the can is a few dozen pixels.
        moving = (clean - self.median).abs().amax(1, keepdim=True) > options.foreground_threshold
        clean, moving = shifted(clean, moving, options.shift, generator)
        disturbed = augment(clean, options.noise, options.colour, generator)
        with torch.autocast(device.type, torch.bfloat16, enabled=options.precision == "bfloat16"):
            feature = self.model.encode(disturbed).float()
            noise = torch.randn(feature.shape, generator=generator).to(device)
            decoded = self.model.decode(feature + options.feature_noise * noise)
        error = (decoded.float() - clean).square()
        weight = 1.0 + (options.foreground_weight - 1.0) * moving
        loss = (weight * error).mean() / weight.mean()
        return loss, {"loss": loss, "mse": error.mean(), "least_feature_std": feature.std(0).min()}

    def weight_file(self, done: int) -> Path:
        """One for all checkpoints."""
        return self.options.out / "cae.safetensors"

    def export(self, path: Path, done: int) -> None:
        save_autoencoder(path, self.model, self.metadata | {"step": done})


def train_cae(options: CaeOptions) -> Path:
    """Runs the training and returns the path of the weight file."""
    require_number("--batch-size", options.batch_size, 2, math.inf)  # batch norm needs two; the most is known already
    prepare(options)
    options = options.with_precision()
    frames = load_frames(options.data)
    metadata = {"training": options.as_metadata(), "data_hash": read_header(options.data).content_hash}
    print(f"{len(frames)} training frames, {frames.nbytes / 1e9:.2f} GB; {options.max_images} images to show")
    training = CaeTraining(options, frames, metadata)
    made_from = {"data": content_of(options.data)}
    fit(training, options, made_from, name="cae", log_every=20)
    return training.weight_file(training.steps)
