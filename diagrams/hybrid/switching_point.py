"""The switching point as an attractor: fixed points of the closed loop's map over one tick, and their stability.

What is held, and what the map leaves out: see one_tick_map.py.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydrake.systems.analysis import Simulator

from diagrams.episodes.compatibility import require_trained_for
from diagrams.hybrid.common import Arguments
from diagrams.hybrid.fixed_point import measure_decay, nearest_fixed_point
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, ENCODER, SPOTS, WEIGHTS
from diagrams.world.scenario import naming_file
from diagrams.world.station import PickPlaceStation
from diagrams.world.task import lifted
from diagrams.world.trajectory import subtask_commands
from models.checks import Range
from models.errors import InputError
from systems.detector import alpha_of
from systems.image_encoder import ImageEncoder
from systems.recall_detector import recall_errors

if TYPE_CHECKING:
    from models.files.weights import StoredPolicy

WRITTEN_EIGENVALUES = 40  # the largest
JACOBIAN_TOLERANCE = 1e-5  # largest difference to finite differences
DECAY_TOLERANCE = 0.1  # relative, of the logarithm of the factor


@dataclass
class Linearize(Arguments):
    """The switching point as a fixed point of one tick: eigenvalues, and decay predicted and simulated."""

    policies: list[Path] = field(default_factory=lambda: [WEIGHTS / "lstm.onnx"])  # policy files to compare
    encoder: Path = WEIGHTS / ENCODER  # file of the encoder
    samples: int = 10  # perturbations simulated for each network and subtask
    can: tuple[float, float] = (0.53, 0.0)  # X Y, m, world
    vacant: str = "left"  # spot on the shelf: left or right

    NAME: ClassVar[str] = "linearize"
    RANGES: ClassVar[dict[str, Range]] = {"samples": (1, 10_000)}

    def run(self) -> int:
        """Analyses each policy before each subtask; returns 0 if Jacobians and decays are as predicted, else 1."""
        import torch
        from tqdm import tqdm

        from diagrams.drawing.spectra import save_spectra
        from diagrams.episodes.sampling import EpisodeSampler
        from models.files.container import file_hash
        from models.files.weights import load_policy
        from models.inference import Encoder

        if self.vacant not in SPOTS:
            raise InputError(f"there is no spot {self.vacant}: choose --vacant one of {', '.join(SPOTS)}")
        torch.set_num_threads(1)  # fastest at batch 1, and the sums of every evaluation
        world, encoder = self.loaded_world(), Encoder(self.encoder)
        EpisodeSampler(world).require_reachable(self.can)
        policies = [(path, load_policy(path)) for path in self.policies]
        for path, stored in policies:
            with naming_file(path, "policy"):
                require_trained_for(world, stored)
            if stored.encoder_hash != encoder.hash:
                raise InputError(
                    f"{path} was trained with another encoder than {self.encoder}: give that one with --encoder"
                )
        images = subtask_images(world, encoder, self.can, self.vacant)
        cases, pictures = [], []
        jobs = [(path, stored, image) for path, stored in policies for image in images]
        for path, stored, image in tqdm(jobs, desc="linearize", unit="case", disable=None):
            found, norms = analyse(world, stored, image, samples=self.samples, seed=self.seed)
            name = {"policy": path.name, "hash": file_hash(path), "rnn": stored.rnn.name}
            cases.append(name | found | {"eigenvalues": found["eigenvalues"][:WRITTEN_EIGENVALUES]})
            pictures.append((f"{path.stem}, subtask {image.subtask}", found["eigenvalues"], norms))
            print(
                f"{path.name}, subtask {found['subtask']}: {found['kind']} {found['distance_deg']:.2f} deg from the "
                f"initial posture, spectral radius {found['spectral_radius']:.4f}; factor a tick predicted "
                f"{found['decay_predicted']:.4f}, simulated {found['decay_measured']:.4f}; "
                f"Jacobian off by {found['jacobian_error']:.1e}",
                flush=True,
            )
        worst = max(cases[: len(images)], key=lambda case: case["spectral_radius"])
        of_worst = {name: worst[name] for name in ("spectral_radius", "decay_predicted", "decay_measured")}
        largest = {name: max(case[name] for case in cases) for name in ("jacobian_error", "decay_error")}
        scene = {"can": self.can, "vacant": self.vacant}
        self.write(of_worst | largest | scene | {"cases": cases})
        save_spectra(pictures, self.out / "linearize.png")
        agree = largest["jacobian_error"] <= JACOBIAN_TOLERANCE and largest["decay_error"] <= DECAY_TOLERANCE
        return 0 if agree else 1


@dataclass(frozen=True)
class SubtaskImage:
    """What the controller sees at the switching point before a subtask."""

    subtask: int
    features: np.ndarray  # (F,) scaled
    posture: np.ndarray  # (8,) rad and m


def subtask_images(world: World, encoder, can_xy: tuple[float, float], vacant: str) -> list[SubtaskImage]:
    """The scene before subtask 1 (can on the desk) and before subtask 2 (can in the hand), the arm at home.

    Between the two the teacher picks the can in physics; raises InputError where that fails.
    """
    station = PickPlaceStation(world)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.set_scene(context, np.asarray(can_xy), vacant)
    desired = station.GetInputPort("desired_posture")
    desired.FixValue(context, world.initial_posture)
    simulator.Initialize()
    eye = ImageEncoder(encoder, world.camera.width, world.camera.height)
    seen = eye.CreateDefaultContext()

    def look(subtask: int) -> SubtaskImage:
        eye.GetInputPort("rgb_image").FixValue(seen, station.GetOutputPort("rgb_image").Eval(context))
        opening = desired.Eval(context)[-1]
        features = eye.GetOutputPort("features").Eval(seen).copy()
        return SubtaskImage(subtask, features, np.append(world.initial_posture[:-1], opening))

    first = look(1)
    hand = HandKinematics(world)
    rows = subtask_commands(world, hand, np.array([*can_xy, CAN_HALF_HEIGHT]), 1)
    for k, row in enumerate(rows, start=1):
        desired.FixValue(context, row)
        simulator.AdvanceTo(k * world.timing.period)
    if not lifted(station.GetOutputPort("can_poses").Eval(context)):
        raise InputError(f"the teacher does not pick the can at {can_xy}: choose another place with --can")
    return [first, look(2)]


def analyse(
    world: World, stored: "StoredPolicy", image: SubtaskImage, *, samples: int, seed: int
) -> tuple[dict, list[np.ndarray]]:
    """Fixed point, eigenvalues and decay for one network and one subtask's image; each perturbation's norms (ticks,).

    In the report, plain types, `decay_predicted` and `decay_measured` are factors a tick (above 1: growth),
    `decay_error` is the largest relative error of the logarithm of any sample's factor, `jacobian_error` the largest
    difference to finite differences.
    """
    from diagrams.hybrid.one_tick_map import OneTickMap

    loop = OneTickMap(world, stored, image.features)
    size = loop.posture_size
    start = np.concatenate((np.zeros(loop.state_size), stored.scaling.scale(image.posture)))
    point = nearest_fixed_point(loop, loop.jacobian, start, size)
    J = loop.jacobian(point.z)
    eigenvalues = np.linalg.eigvals(J)
    eigenvalues = eigenvalues[np.argsort(-np.abs(eigenvalues))]
    radius = float(np.abs(eigenvalues[0]))
    rng = np.random.default_rng(seed)
    decays = [measure_decay(loop, point.z, radius, rng) for _ in range(samples)]
    measured = float(np.exp(np.mean(np.log([decay for decay, _ in decays]))))
    offset = np.abs(stored.scaling.unscale(point.z[-size:]) - image.posture)[:ARM_JOINTS]
    report = {
        "subtask": image.subtask,
        "kind": "fixed point" if point.converged else "slow point",
        "residual": point.residual,
        "distance_deg": float(np.rad2deg(offset.max())),
        "state_rms": float(np.sqrt(np.mean(point.z[:-size] ** 2))),
        "alpha": _alpha(stored, point.z, loop(point.z), size),
        "spectral_radius": radius,
        "decay_predicted": radius,
        "decay_measured": measured,
        "decay_error": float(max(abs(np.log(decay) / np.log(radius) - 1.0) for decay, _ in decays)),
        "jacobian_error": float(np.max(np.abs(J - loop.difference_jacobian(point.z)))),
        "eigenvalues": [[float(v.real), float(v.imag)] for v in eigenvalues],
    }
    return report, [norms for _, norms in decays]


def _alpha(stored: "StoredPolicy", z: np.ndarray, after: np.ndarray, size: int) -> float | None:
    """alpha of a network that rests at z, by Eqs. 5 and 6; None without recall heads or calibration.

    `after`: what the map makes of z; its posture is the prediction.
    """
    import torch

    if stored.recall is None or stored.mean_errors is None or stored.beta is None or stored.gamma is None:
        return None
    with torch.no_grad():
        recalled = stored.recall(torch.from_numpy(z[None, :-size]).float())[0].double().numpy()
    offsets = np.vstack((after[-size:], recalled)) - z[-size:]
    errors = recall_errors(offsets, ARM_JOINTS, np.array(stored.mean_errors))
    return float(alpha_of(errors, stored.beta, stored.gamma))
