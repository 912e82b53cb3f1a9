"""A certificate for mode `return`: from which postures the LQR brings the arm home, how fast; and its test.

In this mode the command is m + clamp(-K (m - m_0)) once a tick, and the servo follows with an error e. S of the
discrete Riccati equation makes V = (m - m_0)' S (m - m_0) a Lyapunov function of the ideal loop: V[k+1] <= rate V[k].
The certified set is the largest level set of V

- within the joint limits,
- in which no step of the command is clamped by the joints' speeds,
- in which the servo's error |e| <= eta |K (m - m_0)|, in V's norm, leaves the loop contracting.

eta is measured on postures of its own, with a safety factor, before any posture of the proof is simulated. What the
certificate does not cover is contact: that share is measured.
"""

from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid.common import NetworkArguments
from diagrams.hybrid.lyapunov import SAFETY_FACTOR, Lyapunov
from diagrams.hybrid.return_trajectories import Sample, Trajectory, sample_postures, trajectories_home
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from models.errors import InputError

V_TOLERANCE = 1e-3  # of the level that bounds "at home": V may rise by that much from tick to tick
FLOOR = 1e-2  # of that level: below it a ratio of two values of V says nothing


@dataclass
class Return(NetworkArguments):
    """The certificate of mode `return`, and its proof on the full plant."""

    samples: int = 10_000  # postures inside the certified set
    outside: int | None = None  # postures outside; default: a fifth of the samples
    workers: int = 2

    LEAST: ClassVar[dict[str, int]] = {"samples": 1, "outside": 0, "workers": 0}

    def run(self) -> int:
        """Makes and tests the certificate; returns 0 if the simulations bear it out, else 1."""
        from diagrams.drawing.return_certificate import save_certificate
        from models.files.policies import read_policy

        world = self.world()
        units = read_policy(self.policy_path)[0].scaling.half_range[:ARM_JOINTS]
        sizes = {"samples": self.samples, "outside": self.samples // 5 if self.outside is None else self.outside}
        path = self.out / "return_trajectories.jsonl"
        with RowStore(path, fingerprint(world, "diagrams/hybrid")) as store, Pool(self.workers) as pool:
            found, picture = certify(world, units, **sizes, seed=self.seed, pool=pool, store=store)
        self.write("return", found)
        save_certificate(picture, self.out / "return.png")
        path.unlink()  # it is for a run that is broken off
        print(
            f"inside: {found['failures_inside']} of {found['samples_inside']} fail to come home; V rises by at most "
            f"{found['max_v_increase']:.2e} (tolerance {found['v_tolerance']:.2e}); V contracts by "
            f"{found['contraction_rate_measured']:.3f} a tick (certified {found['contraction_rate']:.3f})\n"
            f"outside: {found['failures_outside']} of {found['samples_outside']} fail; straight paths home that touch "
            f"something: {found['collision_share']} inside, {found['collision_share_outside']} outside"
        )
        return 0 if holds(found) else 1


@dataclass(frozen=True)
class Certificate:
    """The certified set {V <= level}, and what is promised in it."""

    lyapunov: Lyapunov
    levels: dict[str, float]  # by what bounds the set
    at_home: float  # level within which every joint is at home
    eta: float  # relative tracking error that is allowed for
    calibrated: int  # postures that it was measured on

    @property
    def level(self) -> float:
        """Of the certified set."""
        return min(self.levels.values())

    @property
    def rate(self) -> float:
        """Contraction of V a tick."""
        return self.lyapunov.rate_with(self.eta)

    @property
    def ticks_home(self) -> int:
        """After which the arm is at home."""
        return int(np.ceil(np.log(self.level / self.at_home) / -np.log(self.rate)))


def make_certificate(
    world: World, units: np.ndarray, count: int, rng: np.random.Generator, pool: Pool, store: RowStore
) -> Certificate:
    """The certificate, with the tracking error measured on `count` postures; see `certify`."""
    lower, upper, speed = (v[:ARM_JOINTS] for v in controller_limits(PickPlaceStation(world, camera=False)))
    home = world.initial_posture[:ARM_JOINTS]
    lyapunov, eye = Lyapunov.of(world, units), np.eye(ARM_JOINTS)
    levels = {
        "joint_limits": lyapunov.level_within(eye, np.minimum(upper - home, home - lower)),
        "step_limits": lyapunov.level_within(lyapunov.gain, speed * world.timing.period),
    }
    at_home = lyapunov.level_within(eye, np.full(ARM_JOINTS, HOME_TOLERANCE))
    samples = sample_postures(world, lyapunov, min(levels.values()), count, rng)
    etas, starts = [], []
    for trajectory in trajectories_home(world, samples, pool, store, "tracking error"):
        if trajectory.touches is None and trajectory.broke_off is None:  # the servo's error, not that of an arm held up
            values = lyapunov.value(trajectory.rows - home)
            above = values[:-1] > FLOOR * at_home
            etas.append(float(np.max(lyapunov.relative_error(trajectory.rows, home)[above], initial=0.0)))
            starts.append(float(values[0]))
    if not etas:
        raise InputError(
            f"each of {count} straight paths home to measure the tracking error on touches something: "
            "raise --samples, or clear the scene"
        )
    levels["servo"] = lyapunov.servo_level(starts, etas)
    eta = max((e for e, v in zip(etas, starts, strict=True) if v < min(levels.values())), default=0.0)
    return Certificate(lyapunov, levels, at_home, SAFETY_FACTOR * eta, len(etas))


def certify(
    world: World, units: np.ndarray, *, samples: int, outside: int, seed: int, pool: Pool, store: RowStore
) -> tuple[dict, dict]:
    """The certificate and its proof: the report, plain types, and what diagrams/drawing/return_certificate.py draws.

    `units` (7,) rad: of the regulator's weights, the controller's scaling; `samples`, `outside`: postures simulated
    inside and outside the certified set; `store`: see `trajectories_home`. Raises InputError where no straight path is
    clear that the tracking error could be measured on.
    """
    # Three streams: what the certificate is made from must not be what it is tested on.
    calibration, inner, outer = (np.random.default_rng([seed, stream]) for stream in range(3))
    certificate = make_certificate(world, units, max(samples // 20, 10), calibration, pool, store)
    lyapunov, level = certificate.lyapunov, certificate.level
    home, period = world.initial_posture[:ARM_JOINTS], world.timing.period
    hand = HandKinematics(home)
    starts_in = sample_postures(world, lyapunov, level, samples, inner)
    starts_out = sample_postures(world, lyapunov, level, outside, outer, (hand.lower, hand.upper))
    inside = trajectories_home(world, starts_in, pool, store, "inside")
    beyond = trajectories_home(world, starts_out, pool, store, "outside")

    failed = np.array([trajectory.arrival(home) < 0 for trajectory in beyond], bool)
    values = [lyapunov.value(trajectory.rows - home) for trajectory in inside]
    report = {
        "samples_inside": samples,
        **_inside(certificate, inside, values, home, period),
        "broke_off": [t.broke_off for t in (*inside, *beyond) if t.broke_off is not None],
        "samples_outside": outside,
        "failures_outside": int(failed.sum()),
        "contraction_rate": certificate.rate,
        "contraction_rate_ideal": lyapunov.rate,
        "time_home_certified_s": certificate.ticks_home * period,
        "v_tolerance": V_TOLERANCE * certificate.at_home,
        "level": level,
        "levels": certificate.levels,
        "level_at_home": certificate.at_home,
        "semi_axes_deg": np.rad2deg(np.sqrt(level * np.diag(np.linalg.inv(lyapunov.P)))).tolist(),
        "tracking_error": {"eta": certificate.eta, "safety_factor": SAFETY_FACTOR, "postures": certificate.calibrated},
        "S": lyapunov.P.tolist(),
        "collision_share": _shares(inside),
        "collision_share_outside": _shares(beyond),
    }

    def drawn(samples: list[Sample], trajectories: list[Trajectory]) -> dict:
        hands = [hand.grasp_position(sample.joints) for sample in samples]
        return {"hands": np.reshape(hands, (-1, 3)), "touches": [t.touches for t in trajectories]}

    picture = {
        "values": values, "level": level, "rate": certificate.rate, "at_home": certificate.at_home,
        "period": period, "home": hand.grasp_position(home), "grid": world.grid.bounds,
        "inside": drawn(starts_in, inside), "outside": drawn(starts_out, beyond) | {"failed": failed},
    }  # fmt: skip
    return report, picture


def _inside(
    certificate: Certificate, trajectories: list[Trajectory], values: list[np.ndarray], home: np.ndarray, period: float
) -> dict:
    """What the trajectories from inside the set did; `values`: V along each of them."""
    arrivals = np.array([trajectory.arrival(home) for trajectory in trajectories])
    clear = np.array([trajectory.touches is None for trajectory in trajectories])
    floor = FLOOR * certificate.at_home
    rates = np.array([np.max(v[1:][v[:-1] > floor] / v[:-1][v[:-1] > floor], initial=0.0) for v in values])
    found = arrivals[arrivals >= 0]
    home_s = {"median": float(np.median(found) * period), "max": float(found.max() * period)} if len(found) else None
    return {
        "failures_inside": int(np.sum(arrivals < 0)),
        "later_than_certified": int(np.sum((arrivals < 0) | (arrivals > certificate.ticks_home))),
        "contraction_rate_measured": float(rates.max()),
        "contraction_rate_measured_clear": float(rates[clear].max(initial=0.0)),
        "time_home_measured_s": home_s,
        "max_v_increase": float(max(np.max(np.diff(v), initial=-np.inf) for v in values)),
    }


def holds(report: dict) -> bool:
    """Whether the measurement bears the certificate out; the rate on clear paths, as it does not cover contact."""
    return (
        report["failures_inside"] == 0
        and report["later_than_certified"] == 0
        and report["max_v_increase"] <= report["v_tolerance"]
        and report["contraction_rate_measured_clear"] <= report["contraction_rate"]
    )


def _shares(trajectories: list[Trajectory]) -> dict[str, float]:
    """Share of the straight paths home that touch something, by what is touched first."""
    names = Counter(t.touches for t in trajectories if t.touches is not None)
    total = max(len(trajectories), 1)
    return {"any": names.total() / total} | {name: names[name] / total for name in sorted(names)}
