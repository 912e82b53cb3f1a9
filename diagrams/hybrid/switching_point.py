"""The switching point as an attractor: fixed points of the closed loop's map over one tick, and their stability.

Held: the image features of a scene, and alpha = 0 (mode `task`). Two idealisations: the arm is at the commanded posture one tick later (the
servo's lag is a few percent of a step), and the features do not change while the posture does.

State of the map, and why no more: z = (c, m), the network's hidden state (S) and the scaled posture (8, its last component the *command* of the
fingers). The last prediction enters the loop only times alpha (Eqs. 7, 8), the recalled postures only through alpha; alpha and its derivative
are next to nothing at a fixed point, where nothing moves and all is recalled (`alpha` in the report measures it).

    y, c+ = rnn([m, f], c)                the policy: torch, float64 copy of the weights, Jacobian by torch.func
    m+    = mixer(m, clip(y), regulator(m), alpha = 0)      Eq. 3: Drake's systems, Jacobian by AutoDiffXd
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from diagrams.episodes.rollout import controller_limits
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.scenario import World
from diagrams.world.station import ARM_JOINTS, CAN_HALF_HEIGHT, PickPlaceStation
from diagrams.world.trajectory import SUBTASK_STEPS, commands, subtask_waypoints
from models.errors import InputError
from models.files.weights import StoredPolicy
from models.networks.rnn import RecurrentNetwork
from systems.detector import alpha_of
from systems.image_encoder import ImageEncoder
from systems.recall_detector import recall_errors
from systems.regulated_mixer import RegulatedMixer

NEWTON_STEPS = 60
RESIDUAL = 1e-11  # largest component of F(z) - z at a fixed point, scaled units
DIFFERENCE = 1e-5  # of the central differences, scaled units
PERTURBATION = 1e-5  # norm, scaled units
DECAY_TICKS = (60, 3000)  # at least and at most, of the simulated decay


@dataclass(frozen=True)
class SubtaskImage:
    """What the controller sees at the switching point before a subtask: features (F,), scaled, and posture (8,), rad and m."""

    subtask: int
    features: np.ndarray
    posture: np.ndarray


def subtask_images(world: World, encoder, can_xy: tuple[float, float], vacant: str) -> list[SubtaskImage]:
    """The scene before subtask 1 (the can on the desk) and before subtask 2 (the can in the hand), arm at the initial posture.

    Between the two the teacher picks the can in physics. `encoder`: see models/inference.py.
    """
    builder = DiagramBuilder()
    station = builder.AddSystem(PickPlaceStation(world))
    size = world.camera.width, world.camera.height
    eye = builder.AddNamedSystem("image_encoder", ImageEncoder(encoder, *size))
    builder.Connect(station.GetOutputPort("rgb_image"), eye.GetInputPort("rgb_image"))
    builder.ExportInput(station.GetInputPort("desired_posture"), "desired_posture")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    station.set_scene(context, np.asarray(can_xy), vacant)
    desired = diagram.GetInputPort("desired_posture")
    desired.FixValue(context, world.initial_posture)
    simulator.Initialize()

    def look(subtask: int) -> SubtaskImage:
        features = eye.GetOutputPort("features").Eval(eye.GetMyContextFromRoot(context)).copy()
        opening = desired.Eval(context)[-1]
        return SubtaskImage(subtask, features, np.append(world.initial_posture[:-1], opening))

    first = look(1)
    hand = HandKinematics(world.initial_posture[:ARM_JOINTS])
    way = subtask_waypoints(world, hand, np.array([*can_xy, CAN_HALF_HEIGHT]), 1)
    for k, row in enumerate(commands(way, SUBTASK_STEPS[0]), start=1):
        desired.FixValue(context, row)
        simulator.AdvanceTo(k * world.timing.period)
    if station.GetOutputPort("can_poses").Eval(station.GetMyContextFromRoot(context))[6] < 2 * CAN_HALF_HEIGHT:
        raise InputError(f"the teacher does not pick the can at {can_xy}: choose another place with --can")
    return [first, look(2)]


class OneTickMap:
    """The map z -> z+ of one tick with everything that it is differentiated by; see the module's docstring."""

    def __init__(self, world: World, stored: StoredPolicy, features: np.ndarray):
        """`stored`: network, scaling and gain; `features` (F,), held."""
        self.rnn: RecurrentNetwork = copy.deepcopy(stored.rnn).double()
        self.state_size, self.posture_size = self.rnn.state_size, self.rnn.posture_size
        if len(features) != self.rnn.feature_size:
            raise InputError(f"{len(features)} features do not fit the network, which takes {self.rnn.feature_size}")
        self._features = torch.tensor(np.asarray(features), dtype=torch.float64)
        self._law = _law(world, stored)
        self._law_context = self._law.CreateDefaultContext()
        self._law_ad = self._law.ToAutoDiffXd()
        self._law_ad_context = self._law_ad.CreateDefaultContext()
        for law, context in ((self._law, self._law_context), (self._law_ad, self._law_ad_context)):
            for port in ("alpha", "last_alphas"):
                law.GetInputPort(port).FixValue(context, np.zeros(1))

    def join(self, hidden: np.ndarray, posture: np.ndarray) -> np.ndarray:
        """z (S + 8,) of a hidden state (S,) and a scaled posture (8,)."""
        return np.concatenate((hidden, posture))

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """One tick: z (S + 8,) to z+."""
        with torch.no_grad():
            out = self._policy(torch.from_numpy(z)).numpy()
        c, y = out[: self.state_size], out[self.state_size :]
        return np.concatenate((c, self._mix(z[self.state_size :], y)))

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """dz+/dz (S + 8, S + 8) at z."""
        S = self.state_size
        point = torch.from_numpy(z)
        policy = torch.func.jacrev(self._policy)(point).detach().numpy()
        with torch.no_grad():
            y = self._policy(point).numpy()[S:]
        by_posture, by_prediction = self._mix_gradients(z[S:], y)
        lower = by_prediction @ policy[S:]
        lower[:, S:] += by_posture
        return np.vstack((policy[:S], lower))

    def difference_jacobian(self, z: np.ndarray, step: float = DIFFERENCE) -> np.ndarray:
        """The same by central differences of the map."""
        columns = []
        for i in range(len(z)):
            offset = np.zeros(len(z))
            offset[i] = step
            columns.append((self(z + offset) - self(z - offset)) / (2 * step))
        return np.array(columns).T

    def _policy(self, z: torch.Tensor) -> torch.Tensor:
        """z to [c+, clipped posture prediction], differentiable."""
        c, m = z[: self.state_size], z[self.state_size :]
        y, after = self.rnn.step(torch.cat((m, self._features))[None], c[None])
        return torch.cat((after[0], y[0, : self.posture_size].clamp(-1.0, 1.0)))

    def _mix(self, posture: np.ndarray, prediction: np.ndarray) -> np.ndarray:
        law, context = self._law, self._law_context
        law.GetInputPort("posture").FixValue(context, posture)
        law.GetInputPort("predicted_posture").FixValue(context, prediction)
        return law.GetOutputPort("desired_posture").Eval(context).copy()

    def _mix_gradients(self, posture: np.ndarray, prediction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        law, context, size = self._law_ad, self._law_ad_context, self.posture_size
        both = InitializeAutoDiff(np.concatenate((posture, prediction)))[:, 0]
        law.GetInputPort("posture").FixValue(context, both[:size])
        law.GetInputPort("predicted_posture").FixValue(context, both[size:])
        out = law.GetOutputPort("desired_posture").Eval(context)
        assert np.all(np.isfinite(ExtractValue(out)))
        gradient = ExtractGradient(out)
        return gradient[:, :size], gradient[:, size:]


def _law(world: World, stored: StoredPolicy) -> RegulatedMixer:
    """Regulator and mixer, scaled."""
    scaling, size = stored.scaling, stored.rnn.posture_size
    lower, upper, speed = controller_limits(PickPlaceStation(world, camera=False))
    return RegulatedMixer(
        posture_size=size,
        joints=ARM_JOINTS,
        initial_posture=scaling.scale(stored.initial_posture),
        Q=world.regulator.state_weight,
        R=world.regulator.input_weight,
        period=world.timing.period,
        lower=scaling.scale(lower),
        upper=scaling.scale(upper),
        max_step=speed * world.timing.period / scaling.half_range,
    )


@dataclass(frozen=True)
class FixedPoint:
    """Where Newton ended: z, the largest component of F(z) - z, its steps, and from how many ticks of the map it started."""

    z: np.ndarray
    residual: float
    steps: int
    started_after: int

    @property
    def converged(self) -> bool:
        """Whether it is a fixed point; else a slow point, at which the motion is slowest."""
        return self.residual < RESIDUAL


def newton(step, jacobian, start: np.ndarray, started_after: int = 0) -> FixedPoint:
    """Newton's method on F(z) - z = 0 with step halving; where no step makes the residual smaller, it ends at a slow point.

    Args:
        step, jacobian: F and its derivative; start: z, (n,); started_after: noted in the result.
    """
    z = np.array(start, dtype=float)
    residual = step(z) - z
    for count in range(NEWTON_STEPS):
        if np.max(np.abs(residual)) < RESIDUAL:
            return FixedPoint(z, float(np.max(np.abs(residual))), count, started_after)
        direction = np.linalg.lstsq(jacobian(z) - np.eye(len(z)), -residual, rcond=None)[0]
        for share in 0.5 ** np.arange(12):
            candidate = z + share * direction
            after = step(candidate) - candidate
            if np.linalg.norm(after) < np.linalg.norm(residual):
                break
        else:
            break
        z, residual = candidate, after
    return FixedPoint(z, float(np.max(np.abs(residual))), count + 1, started_after)


def nearest_fixed_point(step, jacobian, switching_point: np.ndarray, posture_size: int, starts=(0, 1, 5, 20, 60, 200)):
    """The fixed point with the posture nearest to the switching point's, of those that Newton finds from a few points on the orbit that leaves it.

    Args:
        switching_point: z, (n,): c_0 and the initial posture, its last `posture_size` components.
        starts: ticks of the map before Newton begins.

    Returns:
        The fixed point, or the slowest slow point where there is none.
    """
    found, z, k = [], np.array(switching_point, dtype=float), 0
    for start in starts:
        while k < start:
            z, k = step(z), k + 1
        found.append(newton(step, jacobian, z, start))
    fixed = [point for point in found if point.converged]
    if not fixed:
        return min(found, key=lambda point: point.residual)
    return min(fixed, key=lambda p: np.linalg.norm(p.z[-posture_size:] - switching_point[-posture_size:]))


def measure_decay(
    step, point: np.ndarray, spectral_radius: float, rng: np.random.Generator
) -> tuple[float, np.ndarray]:
    """Factor a tick by which a small random perturbation of `point` (n,) shrinks (or grows) in simulation, and its norms (ticks,).

    The perturbed orbit is compared with the one from `point` itself. Fitted by least squares to the logarithm of the norm over the second half
    of the ticks, when the slowest part is left alone; over as many ticks as double precision (or, growing, linearity) allows.
    """
    rate = max(abs(np.log(max(spectral_radius, 1e-6))), 1e-6)
    # Down from the perturbation to what rounding leaves of it, up to where it is no longer small.
    span = np.log(1e7) if spectral_radius < 1 else np.log(1e3)
    ticks = int(np.clip(span / rate, *DECAY_TICKS))
    direction = rng.normal(size=len(point))
    reference, orbit = point.copy(), point + PERTURBATION * direction / np.linalg.norm(direction)
    norms = [PERTURBATION]
    for _ in range(ticks):
        reference, orbit = step(reference), step(orbit)
        norms.append(float(np.linalg.norm(orbit - reference)))
        if not PERTURBATION * 1e-8 < norms[-1] < PERTURBATION * 1e4:
            break
    half = len(norms) // 2
    slope = np.polyfit(np.arange(half, len(norms)), np.log(np.maximum(norms[half:], 1e-300)), 1)[0]
    return float(np.exp(slope)), np.array(norms)


def analyse(world: World, stored: StoredPolicy, image: SubtaskImage, *, samples: int, seed: int) -> tuple[dict, dict]:
    """Fixed point, eigenvalues and decay for one network and one subtask's image.

    Args:
        samples: perturbations simulated; seed: of their directions.

    Returns:
        The report, plain types: `decay_predicted` and `decay_measured` are factors a tick (above 1: growth), `decay_error` the largest relative
        error of the logarithm of any sample's factor, `jacobian_error` the largest difference to finite differences; and what the picture needs.
    """
    loop = OneTickMap(world, stored, image.features)
    size = loop.posture_size
    start = loop.join(np.zeros(loop.state_size), stored.scaling.scale(image.posture))
    point = nearest_fixed_point(loop, loop.jacobian, start, size)
    J = loop.jacobian(point.z)
    eigenvalues = np.linalg.eigvals(J)
    eigenvalues = eigenvalues[np.argsort(-np.abs(eigenvalues))]
    radius = float(np.abs(eigenvalues[0]))
    rng = np.random.default_rng(seed)
    decays = [measure_decay(loop, point.z, radius, rng) for _ in range(samples)]
    measured = float(np.exp(np.mean(np.log([decay for decay, _ in decays]))))
    posture = stored.scaling.unscale(point.z[-size:])
    report = {
        "subtask": image.subtask,
        "kind": "fixed point" if point.converged else "slow point",
        "residual": point.residual,
        "newton_steps": point.steps,
        "started_after_ticks": point.started_after,
        "distance_deg": float(np.rad2deg(np.abs(posture - image.posture)[:ARM_JOINTS].max())),
        "finger_distance_m": float(np.abs(posture - image.posture)[ARM_JOINTS:].max()),
        "state_rms": float(np.sqrt(np.mean(point.z[:-size] ** 2))),
        "alpha": _alpha(stored, point.z, size),
        "spectral_radius": radius,
        "unstable": int(np.sum(np.abs(eigenvalues) >= 1.0)),
        "decay_predicted": radius,
        "decay_measured": measured,
        "decay_error": float(max(abs(np.log(decay) / np.log(radius) - 1.0) for decay, _ in decays)),
        "jacobian_error": float(np.max(np.abs(J - loop.difference_jacobian(point.z)))),
        "eigenvalues": [[float(v.real), float(v.imag)] for v in eigenvalues[:40]],
    }
    return report, {"eigenvalues": eigenvalues, "norms": [norms for _, norms in decays], "radius": radius}


def _alpha(stored: StoredPolicy, z: np.ndarray, size: int) -> float | None:
    """alpha of a network that rests at z, by Eqs. 5 and 6; None without recall heads or calibration."""
    if stored.recall is None or stored.reference_errors is None or stored.beta is None or stored.gamma is None:
        return None
    with torch.no_grad():
        recalled = stored.recall(torch.from_numpy(z[None, :-size]).float())[0].double().numpy()
    # At rest the prediction is what the regulator pulls against (n = 0).
    pull = stored.regulator_gain * (z[-size:] - stored.scaling.scale(stored.initial_posture))
    offsets = np.vstack((pull, recalled - z[-size:]))
    errors = recall_errors(offsets, ARM_JOINTS, np.array(stored.reference_errors))
    return float(alpha_of(errors, stored.beta, stored.gamma))


def save_spectra(cases: list[tuple[str, dict]], path: Path) -> None:
    """Eigenvalues in the unit circle and the decay of perturbations, a row for each of `cases` (title, what `analyse` gave for the picture)."""
    from diagrams.drawing.style import BLUE, RED, new_figure, save

    figure, axes = new_figure(len(cases), 2, figsize=(10, 3.8 * len(cases)), squeeze=False)
    for (title, data), (left, right) in zip(cases, axes, strict=True):
        angle = np.linspace(0, 2 * np.pi, 400)
        left.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8)
        values = data["eigenvalues"]
        left.plot(values.real, values.imag, ".", color=BLUE, ms=4)
        outside = np.abs(values) >= 1
        left.plot(values.real[outside], values.imag[outside], "o", color=RED, mfc="none")
        left.set_aspect("equal", adjustable="datalim")
        left.set_title(f"{title}: spectral radius {data['radius']:.4f}", fontsize=9)
        left.set_xlabel("real")
        left.set_ylabel("imaginary")
        for norms in data["norms"]:
            right.semilogy(norms, color=BLUE, lw=0.7, alpha=0.6)
        longest = max(data["norms"], key=len)
        half = len(longest) // 2
        ticks = np.arange(half, len(longest))
        right.semilogy(ticks, longest[half] * data["radius"] ** (ticks - half), color=RED, ls="--", label="predicted")
        right.set_xlabel("ticks")
        right.set_ylabel("norm of the perturbation")
        right.legend(fontsize=8)
    save(figure, path)
