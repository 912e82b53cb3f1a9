"""A certificate for mode `return`: from which postures the LQR brings the arm home, how fast; and its test.

In this mode the command is m + clamp(-K (m - m_0)) once a tick, the first steps from rest cut by AccelerationLimit, and
the servo follows with an error. K is a multiple of the identity, so the joints go home each for itself, and V, the
gauge of the box of joint limits (see BoxGauge), falls in the ideal loop from every posture of that box, at rates known
in closed form, also in the first tick, with the step that the cut leaves. What the servo takes from it is measured on
ways home of their own, with a safety factor, before any posture of the proof is simulated: for the postures in which a
disturbance meets or leaves the arm, and for the whole box, where of the first tick from rest it is promised only that V
does not rise. The proof are fresh postures on the full plant, a can in the hand in half of them, with the clearance
filter that runs there: all ways must come home without coming near to anything; V and the certified times are judged on
the ways that are the LQR's alone.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.sampling import SEED_BLOCKS, episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.hybrid.box_gauge import BoxGauge
from diagrams.hybrid.common import Arguments, fingerprint_with_analyses
from diagrams.hybrid.delay_margin import delay_margin, measured_delay_margin
from diagrams.hybrid.return_loop import Trajectory
from diagrams.hybrid.return_promise import SAFETY_FACTOR, Promise
from diagrams.hybrid.return_proof import DRAWN, KINDS, LEAST_DISTANCE, ROUNDING, holds, judge, of_draws, total
from diagrams.hybrid.return_samples import Sample, box_samples, drawn_samples
from diagrams.hybrid.return_trajectories import trajectories_home
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.task import HOME_TOLERANCE
from models.checks import Range
from models.errors import InputError

CALIBRATION_SHARE = 10  # postures or episodes of the proof for one of the calibration
LEAST_CALIBRATION = {"box": 40, "draws": 10}  # postures, episodes


@dataclass
class Return(Arguments):
    """The certificate of mode `return`, and its proof on the full plant."""

    samples: int = 10_000  # postures of the proof, uniform in the box
    draws: int = 1000  # episodes whose onset posture and target of disturbance A are looked at, and simulated
    workers: int = 2  # processes; 0: this one

    NAME: ClassVar[str] = "return"
    RANGES: ClassVar[dict[str, Range]] = {
        "seed": (0, SEED_BLOCKS - 1),
        "samples": (1, 10**6),
        "draws": (1, 9000),
        "workers": (0, MOST_WORKERS),
    }

    def run(self) -> int:
        """Makes and tests the certificate; returns 0 if the simulations bear it out, else 1."""
        from diagrams.drawing.return_certificate import save_certificate

        world, path = self.loaded_world(), self.out / "return_trajectories.jsonl"
        if world.regulator.offset > 0.0:
            raise InputError(
                f"world.regulator.offset {world.regulator.offset:g} rad: the certificate is of the way home from the "
                "measured posture alone, leave it at 0"
            )
        identity = fingerprint_with_analyses(world)
        with RowStore(path, identity) as store, Pool(self.workers) as pool:
            found, picture = certify(
                world, samples=self.samples, draws=self.draws, seed=self.seed, pool=pool, store=store
            )
            self.write({"fingerprint": identity} | found)
            save_certificate(picture, self.out / "return.png")
            path.unlink(missing_ok=True)  # it is for a run that is broken off; while no other program can open it
        print(words(found))
        return 0 if holds(found) else 1


@dataclass(frozen=True)
class Certificate:
    """What is promised in the box, by what the postures are: of `box`, or `onsets` and `targets`."""

    gauge: BoxGauge
    at_home: float  # level of V within which every joint is at home
    promises: dict[str, Promise]


def make_certificate(
    world: World, samples: int, seeds: list[int], rng: np.random.Generator, pool: Pool, store: RowStore
) -> Certificate:
    """The certificate, from `samples` postures on the box's border, drawn by `rng`, and the episodes of `seeds`.

    See `certify`.
    """
    gauge = BoxGauge.of(world)
    home, at_home = world.initial_posture[:ARM_JOINTS], gauge.level_within(HOME_TOLERANCE)

    def measured(chosen: list[Sample], ideal: float, apart: bool) -> Promise:
        ways = trajectories_home(world, chosen, pool, store, "calibration")
        free = [way.rows - home for way in ways if way.free]
        first = [float(gauge.first_rate(rows[0])) for rows in free]
        values, farthest = [gauge.value(rows) for rows in free], gauge.farthest_first_rate
        return Promise.measured(values, first, ideal, farthest, at_home, apart)

    onsets, targets = drawn_samples(world, seeds, pool, store, "calibration")
    # Only joint 1 reaches so far that its speed clamps a step, beyond 120 degrees: A moves it by 40 at most.
    drawn = measured(onsets + targets, 1.0 - gauge.gain, apart=False)
    box = measured(box_samples(world, gauge, samples, rng, border=True), gauge.ideal_rate, apart=True)
    return Certificate(gauge, at_home, {"box": box, "onsets": drawn, "targets": drawn})


def certify(
    world: World, *, samples: int, draws: int, seed: int, pool: Pool, store: RowStore
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The certificate and its proof: the report, plain types, and what diagrams/drawing/return_certificate.py draws.

    `samples`: postures of the proof, uniform in the box; `draws`: episodes; `store`: see `trajectories_home`. Raises
    InputError as `BoxGauge.of`, `Promise.measured` and `episode_seeds` do.
    """
    # What the certificate is made from must not be what it is tested on: two streams, and episodes of their own.
    calibration, proof = (np.random.default_rng([seed, stream]) for stream in range(2))
    fitted = max(samples // CALIBRATION_SHARE, LEAST_CALIBRATION["box"])
    fitted_draws = max(draws // CALIBRATION_SHARE, LEAST_CALIBRATION["draws"])
    seeds = episode_seeds("certificate", seed, fitted_draws + draws)
    certificate = make_certificate(world, fitted, seeds[:fitted_draws], calibration, pool, store)
    gauge, home, period = certificate.gauge, world.initial_posture[:ARM_JOINTS], world.timing.period

    onsets, targets = drawn_samples(world, seeds[fitted_draws:], pool, store, "draws")
    starts = {"box": box_samples(world, gauge, samples, proof), "onsets": onsets, "targets": targets}
    levels = {kind: gauge.value(np.array([s.joints for s in starts[kind]]) - home) for kind in KINDS}
    inside = {kind: [s for s, v in zip(starts[kind], levels[kind], strict=True) if v <= 1.0] for kind in KINDS}
    ways: dict[str, list[Trajectory]] = {
        kind: trajectories_home(world, chosen, pool, store, f"proof, {kind}") for kind, chosen in inside.items()
    }
    values = {kind: [gauge.value(way.rows - home) for way in ways[kind]] for kind in KINDS}
    promises, at_home = certificate.promises, certificate.at_home
    ideal = {
        kind: gauge.first_rate(np.array([s.joints for s in inside[kind]]).reshape(-1, ARM_JOINTS) - home)
        for kind in KINDS
    }
    sets = {
        kind: judge(inside[kind], ways[kind], values[kind], promises[kind], ideal[kind], at_home, home, period)
        for kind in KINDS
    }
    outside, failed = of_draws([levels[kind] for kind in DRAWN], [ways[kind] for kind in DRAWN], home)
    report = {
        **total(sets),
        "period_s": period,
        "draws": draws,
        "draws_outside": outside,
        "draws_failed_or_touched": failed,
        "coverage_onsets": float(np.mean(levels["onsets"] <= 1.0)),
        "coverage_targets": float(np.mean(levels["targets"] <= 1.0)),
        "sets": sets,
        "contraction_rate_ideal": {"unclamped": 1.0 - gauge.gain, "box": gauge.ideal_rate},
        "safety_factor": SAFETY_FACTOR,
        "level_at_home": at_home,
        "core_deg": float(np.rad2deg(gauge.core)),
        "reach_deg": {"down": np.rad2deg(gauge.down).tolist(), "up": np.rad2deg(gauge.up).tolist()},
        "delay_margin_ticks": delay_margin(gauge.gain),
        "delay_margin_measured_ticks": measured_delay_margin(world, delay_margin(gauge.gain)),
    }
    clear = {kind: [v for v, w in zip(values[kind], ways[kind], strict=True) if w.free] for kind in KINDS}
    picture = {
        "values": clear, "levels": levels, "at_home": at_home, "period": period,
        "promises": {kind: promise.bound(200) for kind, promise in promises.items()},
    }  # fmt: skip
    return report, picture


def _kept(over: float) -> str:
    """Whether the ways keep what is promised of their own first ticks; `over`: see `judge`."""
    return (
        f"one exceeds its own by {over:.4f}" if over > ROUNDING else f"each keeps its own, the nearest by {-over:.4f}"
    )


def words(found: dict[str, Any]) -> str:
    """The report in a few lines."""
    distance = found["nearest_distance_m"]
    nearest = "none comes near to anything" if distance is None else f"the nearest comes to {1e3 * distance:.1f} mm"
    lines = [
        f"inside the box: {found['coverage_onsets']:.1%} of the onset postures, {found['coverage_targets']:.1%} of A's "
        f"targets, of {found['draws']} episodes",
        f"{found['failures_inside']} of {found['samples_inside']} postures of the box fail to come home (95 % bound "
        f"{found['bound_inside']:.2e}); {found['touches_inside']} touch something, {nearest}, hand to the arm's own "
        f"foot {1e3 * found['nearest_foot_m']:.0f} mm",
    ]
    for kind, found_here in found["sets"].items():
        free, everything = found_here["free"], found_here["all"]
        alone = "none of them is the LQR's alone, so that its rate is not tested: raise --samples and --draws"
        if free["samples"]:
            alone = (
                f"of the {free['samples']} that are the LQR's alone {free['later_than_certified']} come later than "
                f"certified ({found_here['time_home_certified_s']:.1f} s); V falls to "
                f"{free['contraction_first_measured']:.4f} of itself at most in the first tick (certified from "
                f"anywhere {found_here['contraction_first']:.4f}; "
                f"{_kept(free['contraction_first_over'])}), then to "
                f"{free['contraction_rate_measured']:.4f} a tick (certified {found_here['contraction_rate']:.4f})"
            )
        lines.append(
            f"{kind}: of {everything['samples']} ways {everything['failures']} fail, {everything['left_box']} leave "
            f"the box, {everything['touches']} touch something, {everything['nearer']} come nearer than "
            f"{1e3 * LEAST_DISTANCE:g} mm (95 % bound {everything['bounds']['nearer']:.2e}), "
            f"{everything['later_than_certified']} come later than certified; {alone}"
        )
    lines.append(f"delay margin {found['delay_margin_ticks']} ticks, measured {found['delay_margin_measured_ticks']}")
    return "\n".join(lines)
