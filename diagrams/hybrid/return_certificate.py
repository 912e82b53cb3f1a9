"""A certificate for mode `return`: from which postures the LQR brings the arm home, how fast, and the proof by simulation.

In this mode the command is m + clamp(-K (m - m_0)) once a tick, and the servo follows with an error e. S of the discrete Riccati equation makes
V = (m - m_0)' S (m - m_0) a Lyapunov function of the ideal loop: V[k+1] <= rate V[k]. The certified set is the largest level set of V

- within the joint limits,
- in which no step of the command is clamped by the joints' speeds,
- in which the servo's error |e| <= eta |K (m - m_0)|, in V's norm, leaves the loop contracting.

eta is measured on postures of its own, with a safety factor, before any posture of the proof is simulated. What the certificate does not cover
is contact: that share is measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagrams.hybrid.return_loop import Sample, Way, ways_home
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, SPOTS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from models.errors import InputError
from systems.posture_regulator import lqr

SAFETY_FACTOR = 1.5  # on the measured tracking error
V_TOLERANCE = 1e-3  # of the level that bounds "at home": V may rise by that much from tick to tick
FLOOR = 1e-2  # of that level: below it a ratio of two values of V says nothing


@dataclass(frozen=True)
class Lyapunov:
    """V = d' P d of the deviation d (7, rad) from the initial posture; `gain` K (7, 7) per tick; `rate`: of the ideal loop, a tick."""

    P: np.ndarray
    gain: np.ndarray
    rate: float

    @classmethod
    def of(cls, world: World, units: np.ndarray) -> Lyapunov:
        """From the Riccati equation with the regulator's weights in units of `units` (7, rad); the gain does not depend on the units."""
        weight = np.diag(1.0 / np.asarray(units) ** 2)
        Q, R = world.regulator.state_weight * weight, world.regulator.input_weight * weight
        K, S = lqr(ARM_JOINTS, Q, R, world.timing.period)
        # V falls by d'(Q + K'RK)d a tick.
        root = np.linalg.inv(np.linalg.cholesky(S))
        fall = np.linalg.eigvalsh(root @ (Q + K.T @ R @ K) @ root.T)[0]
        return cls(S, K, float(1.0 - fall))

    def value(self, deviation: np.ndarray) -> np.ndarray:
        """V of deviations (..., 7), rad."""
        return np.einsum("...i,ij,...j->...", deviation, self.P, deviation)

    def level_within(self, rows: np.ndarray, bounds: np.ndarray) -> float:
        """Largest level on which |rows d| <= bounds for `rows` (n, 7) and `bounds` (n,)."""
        reach = np.einsum("ni,ij,nj->n", rows, np.linalg.inv(self.P), rows)
        return float(np.min(np.asarray(bounds) ** 2 / reach))

    def relative_error(self, rows: np.ndarray, home: np.ndarray) -> np.ndarray:
        """(n - 1,) the servo's error over the step it was given, in V's norm, at the ticks of the joint angles `rows` (n, 7)."""
        deviation = rows - home
        step = -deviation[:-1] @ self.gain.T
        return np.sqrt(self.value(deviation[1:] - deviation[:-1] - step) / self.value(step))

    def rate_with(self, eta: float) -> float:
        """Contraction of V a tick with a relative tracking error of at most `eta`."""
        root = np.linalg.cholesky(self.P)
        largest = np.linalg.norm(root.T @ self.gain @ np.linalg.inv(root.T), 2)
        return float((np.sqrt(self.rate) + eta * largest) ** 2)

    def sample_inside(self, rng: np.random.Generator, level: float, count: int) -> np.ndarray:
        """(count, 7) deviations, rad, uniform in the level set."""
        direction = rng.normal(size=(count, ARM_JOINTS))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        radius = np.sqrt(level) * rng.uniform(size=(count, 1)) ** (1 / ARM_JOINTS)
        return np.linalg.solve(np.linalg.cholesky(self.P).T, (radius * direction).T).T


def draw_samples(
    world: World, lyapunov: Lyapunov, lower: np.ndarray, upper: np.ndarray, level: float, count: int, inside: bool, rng
) -> tuple[list[Sample], int]:
    """`count` samples inside the level set, or (uniform within the joint limits) outside it, and how many draws were no posture at all.

    A draw in which the arm is inside the desk, the shelf or a can is none that an arm can have; it is drawn again.
    """
    from tqdm import tqdm

    clearance, home = CollisionChecker(gap=0.0), world.initial_posture[:ARM_JOINTS]
    corner, opposite = world.grid.bounds
    samples: list[Sample] = []
    impossible = 0
    with tqdm(total=count, desc=f"draw {'inside' if inside else 'outside'}", leave=False, disable=None) as bar:
        while len(samples) < count:
            if inside:
                joints = home + lyapunov.sample_inside(rng, level, 1)[0]
            else:
                joints = rng.uniform(lower, upper)
                if lyapunov.value(joints - home) <= level:
                    continue
            sample = Sample(joints, rng.uniform(corner, opposite), str(rng.choice(SPOTS)))
            clearance.set_scene(sample.can_xy, sample.vacant)
            if clearance.first_touch(joints) is not None:
                impossible += 1
                continue
            samples.append(sample)
            bar.update()
    return samples, impossible


def servo_level(starts: np.ndarray, etas: np.ndarray, lyapunov: Lyapunov) -> float:
    """Level below which the loop contracted with every tracking error measured, enlarged by the safety factor.

    `starts` (n,): V of the postures, `etas` (n,): their largest relative tracking error. Infinite where all of them leave it contracting.
    """
    too_far = [v for v, eta in zip(starts, etas, strict=True) if lyapunov.rate_with(SAFETY_FACTOR * eta) >= 1.0]
    return float(min(too_far, default=np.inf))


def certify(
    world: World, units: np.ndarray, *, samples: int, outside: int, seed: int, workers: int, folder: Path
) -> tuple[dict, dict]:
    """The certificate and its proof.

    Args:
        units: (7,) rad, in which the regulator's weights are meant: the scaling of the controller.
        samples, outside: how many postures inside and outside the certified set are simulated.
        seed: of the postures; workers: processes; folder: for the ways simulated so far, see ways_home.

    Returns:
        The report, plain types, and what the picture needs.

    Raises InputError where no way that the tracking error could be measured on is clear.
    """
    station = PickPlaceStation(world, camera=False)
    lower, upper, speed = (limits[:ARM_JOINTS] for limits in controller_limits(station))
    home, period = world.initial_posture[:ARM_JOINTS], world.timing.period
    lyapunov, eye = Lyapunov.of(world, units), np.eye(ARM_JOINTS)
    levels = {
        "joint_limits": lyapunov.level_within(eye, np.minimum(upper - home, home - lower)),
        "step_limits": lyapunov.level_within(lyapunov.gain, speed * period),
    }
    at_home = lyapunov.level_within(eye, np.full(ARM_JOINTS, HOME_TOLERANCE))
    # Three streams: what the certificate is made from must not be what it is tested on.
    calibration, inner, outer = (np.random.default_rng([seed, stream]) for stream in range(3))

    first = min(levels.values())
    tried, _ = draw_samples(world, lyapunov, lower, upper, first, max(samples // 20, 10), True, calibration)
    etas, starts = [], []
    for sample, way in zip(tried, ways_home(world, tried, workers, "tracking error", folder), strict=True):
        if way.touches is None and way.broke_off is None:  # the servo's error, not that of an arm that is held up
            above = lyapunov.value(way.rows[:-1] - home) > FLOOR * at_home
            etas.append(float(np.max(lyapunov.relative_error(way.rows, home)[above], initial=0.0)))
            starts.append(float(lyapunov.value(sample.joints - home)))
    if not etas:
        raise InputError(
            f"each of {len(tried)} ways home to measure the tracking error on touches something: raise --samples, or clear the scene"
        )
    levels["servo"] = servo_level(np.array(starts), np.array(etas), lyapunov)
    level = min(levels.values())
    eta = SAFETY_FACTOR * max((e for e, v in zip(etas, starts, strict=True) if v < level), default=0.0)
    rate = lyapunov.rate_with(eta)
    ticks_home = int(np.ceil(np.log(level / at_home) / -np.log(rate)))

    drawn_in, impossible_in = draw_samples(world, lyapunov, lower, upper, level, samples, True, inner)
    drawn_out, impossible_out = draw_samples(world, lyapunov, lower, upper, level, outside, False, outer)
    ways_in = ways_home(world, drawn_in, workers, "inside", folder)
    ways_out = ways_home(world, drawn_out, workers, "outside", folder)

    values = [lyapunov.value(way.rows - home) for way in ways_in]
    rises = np.array([np.max(np.diff(v), initial=-np.inf) for v in values])
    arrivals = np.array([way.arrival(home) for way in ways_in])
    arrivals_out = np.array([way.arrival(home) for way in ways_out])
    clear = np.array([way.touches is None for way in ways_in])
    ratios = [v[1:][v[:-1] > FLOOR * at_home] / v[:-1][v[:-1] > FLOOR * at_home] for v in values]
    measured = np.array([np.max(ratio, initial=0.0) for ratio in ratios])
    found = arrivals[arrivals >= 0]
    report = {
        "samples_inside": samples,
        "failures_inside": int(np.sum(arrivals < 0)),
        "failures_inside_clear": int(np.sum((arrivals < 0) & clear)),
        "broke_off": [way.broke_off for way in (*ways_in, *ways_out) if way.broke_off is not None],
        "later_than_certified": int(np.sum((arrivals < 0) | (arrivals > ticks_home))),
        "samples_outside": outside,
        "failures_outside": int(np.sum(arrivals_out < 0)),
        "share_failing_outside": float(np.mean(arrivals_out < 0)) if outside else None,
        "contraction_rate": rate,
        "contraction_rate_ideal": lyapunov.rate,
        "contraction_rate_measured": float(measured.max()),
        "contraction_rate_measured_clear": float(measured[clear].max(initial=0.0)),
        "time_home_certified_s": ticks_home * period,
        "time_home_measured_s": {"median": float(np.median(found) * period), "max": float(found.max() * period)}
        if len(found)
        else None,
        "max_v_increase": float(rises.max()),
        "max_v_increase_clear": float(rises[clear].max(initial=-np.inf)) if clear.any() else None,
        "v_tolerance": V_TOLERANCE * at_home,
        "level": level,
        "levels": {name: value if np.isfinite(value) else None for name, value in levels.items()},
        "level_at_home": at_home,
        "semi_axes_deg": np.rad2deg(np.sqrt(level * np.diag(np.linalg.inv(lyapunov.P)))).tolist(),
        "tracking_error": {"eta": eta, "safety_factor": SAFETY_FACTOR, "postures": len(etas)},
        "S": lyapunov.P.tolist(),
        "units_rad": np.asarray(units).tolist(),
        "collision_share": _shares(ways_in),
        "collision_share_outside": _shares(ways_out),
        "impossible_draws": {"inside": impossible_in, "outside": impossible_out},
    }
    picture = {
        "values": values,
        "level": level,
        "rate": rate,
        "at_home": at_home,
        "period": period,
        "joints": np.array([sample.joints for sample in drawn_in]),
        "touches": [way.touches for way in ways_in],
        "joints_outside": np.array([sample.joints for sample in drawn_out]).reshape(-1, ARM_JOINTS),
        "failed_outside": arrivals_out < 0,
        "touches_outside": [way.touches for way in ways_out],
    }
    return report, picture


def holds(report: dict) -> bool:
    """Whether the measurement bears the certificate out; the rate on clear ways, since contact is not what it covers."""
    return (
        report["failures_inside"] == 0
        and report["later_than_certified"] == 0
        and report["max_v_increase"] <= report["v_tolerance"]
        and report["contraction_rate_measured_clear"] <= report["contraction_rate"]
    )


def _shares(ways: list[Way]) -> dict[str, float]:
    """Share of the straight ways home that touch something (nearer than 1 cm), by what is touched first."""
    names = [way.touches for way in ways if way.touches is not None]
    total = max(len(ways), 1)
    return {"any": len(names) / total} | {name: names.count(name) / total for name in sorted(set(names))}


def save_certificate(picture: dict, world: World, path: Path) -> None:
    """V over time against the certified rate, and where the hand starts whose straight way home touches something."""
    from matplotlib.patches import Rectangle

    from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save
    from diagrams.world.inverse_kinematics import HandKinematics

    figure, axes = new_figure(1, 3, figsize=(15, 4.6))
    length = max(len(v) for v in picture["values"])
    rows = np.array([np.append(v, np.full(length - len(v), np.nan)) for v in picture["values"]]) / picture["level"]
    time = picture["period"] * np.arange(length)
    counted = np.sum(np.isfinite(rows), axis=0) >= max(1, len(rows) // 50)
    quantiles = np.nanquantile(rows[:, counted], [0.0, 0.5, 1.0], axis=0)
    axes[0].fill_between(time[counted], quantiles[0], quantiles[2], color=BLUE, alpha=0.25, lw=0, label="all postures")
    axes[0].semilogy(time[counted], quantiles[1], color=BLUE, label="median")
    axes[0].semilogy(time, picture["rate"] ** np.arange(length), color=RED, ls="--", label="certified")
    axes[0].axhline(picture["at_home"] / picture["level"], color="0.5", lw=0.8, ls=":")
    axes[0].text(time[-1], 1.15 * picture["at_home"] / picture["level"], "at home", ha="right", fontsize=8, color="0.4")
    axes[0].set_ylim(1e-3, 2)
    axes[0].set_xlabel("time (s)")
    axes[0].set_ylabel("V / level of the set")
    axes[0].legend(fontsize=8, loc="lower left")
    axes[0].set_title(f"way home from {len(rows)} postures inside the set", fontsize=10)
    hand = HandKinematics(world.initial_posture[:ARM_JOINTS])
    inside = np.array([hand.grasp_position(joints) for joints in picture["joints"]])
    outside = np.array([hand.grasp_position(joints) for joints in picture["joints_outside"]]).reshape(-1, 3)
    touches, touches_outside = (
        np.array([name or "nothing" for name in picture[key]]) for key in ("touches", "touches_outside")
    )
    colours = dict(zip(("desk", "shelf", "can_to_pick", "can_on_shelf"), (ORANGE, GREEN, RED, "purple"), strict=True))
    for axis, (i, j), title in ((axes[1], (0, 1), "from above"), (axes[2], (0, 2), "from the side")):
        failed, clear = picture["failed_outside"], touches == "nothing"
        axis.plot(*outside[failed][:, [i, j]].T, "x", color="0.5", ms=4, label=f"outside, fails ({failed.sum()})")
        axis.plot(*inside[clear][:, [i, j]].T, ".", color=BLUE, ms=2, alpha=0.4, label=f"inside, clear ({clear.sum()})")
        for where, hands, touched, marker in (
            ("inside", inside, touches, "."),
            ("outside", outside, touches_outside, "^"),
        ):
            for name in [name for name in colours if name in touched]:
                chosen = touched == name
                label = f"{where}, way touches {name} ({chosen.sum()})"
                axis.plot(*hands[chosen][:, [i, j]].T, marker, color=colours[name], ms=5, label=label)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x (m)")
        axis.set_ylabel(f"{'xyz'[j]} (m)")
        axis.set_title(f"where the hand starts, {title}", fontsize=10)
        axis.plot(
            *hand.grasp_position(world.initial_posture[:ARM_JOINTS])[[i, j]], "k+", ms=10, label="initial posture"
        )
    corner, opposite = world.grid.bounds
    axes[1].add_patch(Rectangle((corner[0], corner[1]), *(opposite - corner), fill=False, ls=":", ec="0.4"))
    axes[1].annotate("cans", (opposite[0], corner[1]), fontsize=7, color="0.4", ha="right", va="top")
    axes[1].legend(fontsize=7, loc="best")
    save(figure, path)
