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
V_TOLERANCE = 1e-3  # of the level at home: V may rise by that much from tick to tick


def bound(failures: int, n: int) -> float:
    """The probability of a failure, at most, with 95 % confidence, after `failures` in n: Clopper-Pearson, one-sided.

    Without a failure it is 1 - 0.05^(1/n).
    """
    return float(share_above(n, n - failures))


def judge(
    samples: Sequence[Sample],
    ways: Sequence[Trajectory],
    values: Sequence[np.ndarray],
    promise: Promise,
    at_home: float,
    home: np.ndarray,
    period: float,
) -> dict[str, Any]:
    """The report of one set of postures, plain types: of all of its ways, and of those that are the LQR's alone.

    Args:
        samples, ways: the postures, and what came of them.
        values: V at the ticks of each.
        promise: that is judged; at_home: level of V within which every joint is at home.
        home: (7,) initial posture, rad; period: of the ticks, s.
    """
    free = np.array([way.free for way in ways], bool)
    held = np.array([sample.held for sample in samples], bool)
    dropped = np.array([way.dropped for way in ways], bool)
    arrivals = np.array([way.arrival(home) for way in ways], int)
    certified = promise.ticks_home(at_home)
    found = arrivals[arrivals >= 0]

    def counts(chosen: np.ndarray) -> dict[str, Any]:
        when, v = arrivals[chosen], [x for x, take in zip(values, chosen, strict=True) if take]
        failures, n = int(np.sum(when < 0)), len(when)
        rates = [[float(np.max(part, initial=0.0)) for part in contractions(x, at_home)] for x in v]
        return {
            "samples": n,
            "failures": failures,
            "left_box": sum(bool(x.max() > 1.0 + V_TOLERANCE * at_home) for x in v),
            "later_than_certified": int(np.sum((when < 0) | (when > certified))),
            "bound": bound(failures, n),
            "contraction_first_measured": max((first for first, _ in rates), default=0.0),
            "contraction_rate_measured": max((later for _, later in rates), default=0.0),
            "max_v_increase": float(max((np.max(np.diff(x), initial=-1.0) for x in v), default=-1.0)),
        }

    touched = Counter(way.name for way in ways if way.touches)
    return {
        "contraction_first": promise.first,
        "contraction_rate": promise.later,
        "calibrated_on": promise.calibrated,
        "time_home_certified_s": certified * period,
        "time_home_measured_s": (
            {"median": float(np.median(found) * period), "max": float(found.max() * period)} if len(found) else None
        ),
        "v_tolerance": V_TOLERANCE * at_home,
        "all": counts(np.ones(len(ways), bool)),
        "free": counts(free),
        "touches": {name: touched[name] for name in sorted(touched)},
        "nearest_distance_m": min((way.nearest for way in ways if way.nearest is not None), default=None),
        "held": int(held.sum()),
        "dropped": int(dropped.sum()),
        "dropped_free": int(np.sum(dropped & free)),
        "filtered": sum(bool(way.filtered) for way in ways),
        "broke_off": [way.broke_off for way in ways if way.broke_off is not None],
    }


def total(sets: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What all sets say together; each posture is inside the box."""
    samples, failures = (sum(found["all"][name] for found in sets.values()) for name in ("samples", "failures"))
    free, failures_free = (sum(found["free"][name] for found in sets.values()) for name in ("samples", "failures"))
    distances = [d for found in sets.values() if (d := found["nearest_distance_m"]) is not None]
    return {
        "samples_inside": samples,
        "failures_inside": failures,
        "bound_inside": bound(failures, samples),
        "left_box_inside": sum(found["all"]["left_box"] for found in sets.values()),
        "touches_inside": sum(sum(found["touches"].values()) for found in sets.values()),
        "nearest_distance_m": min(distances),
        "samples_free": free,
        "failures_free": failures_free,
        "bound_free": bound(failures_free, free),
    }


def holds(report: dict[str, Any]) -> bool:
    """Whether the ways that come near to nothing bear the certificate out, in each set; it does not cover contact."""
    return all(
        found["free"]["failures"] == 0
        and found["free"]["left_box"] == 0
        and found["free"]["later_than_certified"] == 0
        and found["free"]["max_v_increase"] <= found["v_tolerance"]
        and found["free"]["contraction_first_measured"] <= found["contraction_first"]
        and found["free"]["contraction_rate_measured"] <= found["contraction_rate"]
        for found in report["sets"].values()
    )
