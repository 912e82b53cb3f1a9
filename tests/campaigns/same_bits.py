"""Which figures are equal to the bit on other versions of Python, Drake, numpy, ONNX Runtime and OpenCV.

    python tests/campaigns/same_bits.py bits.json

The first environment in which it is run writes the file, every other compares itself with it. Prints one line.
Exit code 1: a golden output is off by more than its tolerance (tests/models/test_golden.py).
"""

import hashlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import tyro

from diagrams.episodes.calibration import RECALL, controller_of
from diagrams.episodes.fingerprint import VERSIONS
from diagrams.episodes.record import record_hash
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import EpisodeSampler, episode_seeds
from diagrams.sweeps.cluster import versions
from diagrams.world.configuration import World
from diagrams.world.names import ENCODER, WEIGHTS
from models.command_line import require_writable, run
from tests.models.test_golden import GOLDEN, TOLERANCE, outputs

KINDS = ("none", "A", "B")
SCENES = 5  # of each kind


@dataclass
class SameBitsArguments:
    """Compares with another environment."""

    file: tyro.conf.Positional[Path]  # of the digests of the first


def parse(arguments: list[str] | None = None) -> SameBitsArguments:
    """The command line."""
    return tyro.cli(SameBitsArguments, args=arguments, description=__doc__)


def digest(*content: bytes) -> str:
    """SHA-256, 16 hexadecimal digits."""
    return hashlib.sha256(b"".join(content)).hexdigest()[:16]


def found() -> tuple[dict[str, str], float]:
    """Digests by what they are of; and the golden output farthest off, as a share of its tolerance."""
    golden, bits, worst = json.loads(GOLDEN.read_text()), dict[str, str](), 0.0
    for name, numbers in outputs().items():
        bits[f"golden {name}"] = digest(np.asarray(numbers).tobytes())
        worst = max(worst, float(np.abs(numbers - golden[name]).max()) / TOLERANCE.get(name, 1e-5))
    world, seeds = World(), episode_seeds("validation", 0, SCENES)
    sampler, controller = EpisodeSampler(world), controller_of(WEIGHTS, "lstm", RECALL, None, 0)
    for kind in KINDS:
        bits[f"scenes {kind}"] = digest(*(repr(sampler.sample(seed, kind)).encode() for seed in seeds))
        outcome, record = run_episode(Job(world, WEIGHTS / ENCODER, controller, seeds[0], kind, picture_every=10))
        bits[f"first picture {kind}"] = digest(record.pictures[0].tobytes())
        bits[f"record {kind}"] = record_hash(record)[:16]
        said = {
            name: value for name, value in outcome.to_dict().items() if name not in ("wall_seconds", "realtime_factor")
        }
        bits[f"outcome {kind}"] = digest(json.dumps(said).encode())
        bits[f"verdict {kind}"] = f"{outcome.success} {outcome.switch_success} {outcome.detection_delay_s}"
    return bits, worst


def main(arguments: SameBitsArguments) -> int:
    """Prints what is equal; returns the exit code."""
    require_writable(arguments.file)
    bits, worst = found()
    here = ", ".join(f"{name} {versions()[name]}" for name in ("Python", *VERSIONS))
    if not arguments.file.exists():
        arguments.file.write_text(json.dumps({"versions": here, "bits": bits}, indent=1) + "\n")
        compared = f"written: {arguments.file}"
    else:
        first = json.loads(arguments.file.read_text())
        others = [name for name in first["bits"] if bits.get(name) != first["bits"][name]]
        compared = f"{len(bits) - len(others)} of {len(bits)} equal to the bit to those of {first['versions']}"
        compared += f" (not {', '.join(others)})" if others else ""
    print(f"{here}: golden outputs off by at most {100 * worst:.2g} % of their tolerance; {compared}")
    return int(worst > 1.0)


if __name__ == "__main__":
    run(main, parse)
