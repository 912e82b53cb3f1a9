"""What ways home on the full plant say about a promise: counts, each with the bound that it allows."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from diagrams.episodes.thresholds import share_above
from diagrams.hybrid.return_loop import Trajectory
from diagrams.hybrid.return_promise import Promise, contractions
from diagrams.hybrid.return_samples import Sample

KINDS = ("box", "onsets", "targets")  # of postures
DRAWN = KINDS[1:]  # those of episodes: an onset and a target are of one draw
LEAST_DISTANCE = 0.005  # m
ROUNDING = 1e-9  # of a factor
V_TOLERANCE = 1e-3  # of the level at home: V may rise by that much from tick to tick


def bound(failures: int, n: int) -> float:
    """The probability of a failure, at most, with 95 % confidence, after `failures` in n: Clopper-Pearson, one-sided.

    Without a failure it is 1 - 0.05^(1/n). Raises ValueError for more failures than n.
    """
    if failures > n:
        raise ValueError(f"{failures} of {n} fail: there cannot be more failures than samples")
    return float(share_above(n, n - failures))


def judge(
    samples: Sequence[Sample],
    ways: Sequence[Trajectory],
    values: Sequence[np.ndarray],
    promise: Promise,
    ideal_first: np.ndarray,
    at_home: float,
    home: np.ndarray,
    period: float,
) -> dict[str, Any]:
    """The report of one set of postures, plain types: of all of its ways, and of those that are the LQR's alone.

    Args:
        samples, ways: the postures, and what came of them.
        values: V at the ticks of each.
        promise: that is judged; ideal_first: (n,) of each way, see BoxGauge.first_rate.
        at_home: level of V within which every joint is at home.
        home: (7,) initial posture, rad; period: of the ticks, s.
    """
    free = np.array([way.free for way in ways], bool)
    held = np.array([sample.held for sample in samples], bool)
    dropped = np.array([way.dropped for way in ways], bool)
    touched = np.array([way.touches for way in ways], bool)
    near = np.array([way.closest < LEAST_DISTANCE for way in ways], bool)
    arrivals = np.array([way.arrival(home) for way in ways], int)
    first = promise.first(ideal_first)
    certified = promise.ticks_home(at_home)
    found = arrivals[arrivals >= 0]

    def counts(chosen: np.ndarray) -> dict[str, Any]:
        when, v = arrivals[chosen], [x for x, take in zip(values, chosen, strict=True) if take]
        n, rates = len(when), [[float(np.max(part, initial=0.0)) for part in contractions(x, at_home)] for x in v]
        over = [rate - promised for (rate, _), promised in zip(rates, first[chosen].tolist(), strict=True)]
        counted = {
            "failures": int(np.sum(when < 0)),
            "left_box": sum(bool(x.max() > 1.0 + V_TOLERANCE * at_home) for x in v),
            "later_than_certified": int(np.sum((when < 0) | (when > certified))),
            "touches": int(np.sum(touched[chosen])),
            "nearer": int(np.sum(near[chosen])),  # than LEAST_DISTANCE, those that touch too
            "failed_or_touched": int(np.sum(((arrivals < 0) | touched)[chosen])),
        }
        return {
            "samples": n,
            **counted,
            "bounds": {name: bound(count, n) for name, count in counted.items()},
            "contraction_first_measured": max((rate for rate, _ in rates), default=0.0),
            "contraction_first_over": max(over, default=-1.0),  # the promise of its way; 0 or less: all kept
            "contraction_rate_measured": max((later for _, later in rates), default=0.0),
            "max_v_increase": float(max((np.max(np.diff(x), initial=-1.0) for x in v), default=-1.0)),
        }

    by_name = Counter("foot" if way.foot <= 0.0 else str(way.name) for way in ways if way.touches)
    return {
        "contraction_first": promise.slowest,
        "contraction_rate": promise.later,
        "calibrated_on": promise.calibrated,
        "time_home_certified_s": certified * period,
        "time_home_measured_s": (
            {"median": float(np.median(found) * period), "max": float(found.max() * period)} if len(found) else None
        ),
        "v_tolerance": V_TOLERANCE * at_home,
        "all": counts(np.ones(len(ways), bool)),
        "free": counts(free),
        "touches": {name: by_name[name] for name in sorted(by_name)},
        "nearest_distance_m": min((way.nearest for way in ways if way.nearest is not None), default=None),
        "nearest_foot_m": min((way.foot for way in ways), default=None),
        "held": int(held.sum()),
        "dropped": int(dropped.sum()),
        "dropped_free": int(np.sum(dropped & free)),
        "filtered": sum(bool(way.filtered) for way in ways),
        "broke_off": [way.broke_off for way in ways if way.broke_off is not None],
    }


def of_draws(levels: Sequence[np.ndarray], ways: Sequence[Sequence[Trajectory]], home: np.ndarray) -> tuple[int, int]:
    """How many draws have a posture outside of the box, and how many one that fails to come home or touches something.

    Args:
        levels: V of each draw's posture, an array for each of DRAWN.
        ways: of the postures inside the box, in their order.
        home: (7,) initial posture, rad.
    """
    outside, failed = set[int](), set[int]()
    for v, found in zip(levels, ways, strict=True):
        inside = np.flatnonzero(np.asarray(v) <= 1.0).tolist()
        outside |= set(range(len(v))) - set(inside)
        failed |= {i for i, way in zip(inside, found, strict=True) if way.touches or way.arrival(home) < 0}
    return len(outside), len(failed)


def total(sets: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What is said of the box as a whole: of the postures that are uniform in it."""
    box = sets["box"]
    everything, free = box["all"], box["free"]
    return {
        "samples_inside": everything["samples"],
        "failures_inside": everything["failures"],
        "bound_inside": everything["bounds"]["failures"],
        "left_box_inside": everything["left_box"],
        "touches_inside": everything["touches"],
        "nearer_inside": everything["nearer"],
        "nearest_distance_m": box["nearest_distance_m"],
        "nearest_foot_m": box["nearest_foot_m"],
        "broke_off": [words for found in sets.values() for words in found["broke_off"]],
        "contraction_rate": box["contraction_rate"],
        "contraction_rate_measured": free["contraction_rate_measured"],
        "later_than_certified": free["later_than_certified"],
        "max_v_increase": free["max_v_increase"],
        **{name: box[name] for name in ("time_home_certified_s", "time_home_measured_s", "v_tolerance")},
    }


def holds(report: dict[str, Any], least: float = LEAST_DISTANCE) -> bool:
    """Whether the ways bear the certificate out, in each set.

    All of them come home, in the box, touching nothing and nothing nearer than `least` (m); those that are the LQR's
    alone, at least one, in the certified time, V falling as certified.
    """
    return all(
        found["all"]["failures"] == 0
        and found["all"]["left_box"] == 0
        and found["all"]["touches"] == 0
        and (found["nearest_distance_m"] is None or found["nearest_distance_m"] >= least)
        and (found["nearest_foot_m"] is None or found["nearest_foot_m"] >= least)
        and found["free"]["samples"] > 0
        and found["free"]["later_than_certified"] == 0
        and found["free"]["max_v_increase"] <= found["v_tolerance"]
        and found["free"]["contraction_first_over"] <= ROUNDING
        and found["free"]["contraction_rate_measured"] <= found["contraction_rate"]
        for found in report["sets"].values()
    )
