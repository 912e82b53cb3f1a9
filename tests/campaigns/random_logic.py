"""Random formulas of signal temporal logic, random runs, and RTAMT's value of them."""

import numpy as np

SIGNALS = ("a", "b", "c")
LONGEST = 12  # ticks of an interval


def random_formula(rng: np.random.Generator, depth: int, past: bool) -> str:
    """A formula in the words of systems/signal_logic_text.py, `depth` operators deep at most; `past`: of the past."""
    if depth == 0 or rng.uniform() < 0.1:
        sign = rng.choice(["<", "<=", ">", ">="])
        return f"{_sum(rng)} {sign} {_sum(rng)}"

    def inside() -> str:
        return f"({random_formula(rng, depth - 1, past)})"

    temporal = ["once", "historically", "since"] + ([] if past else ["always", "eventually", "until"])
    word = rng.choice(["not", "and", "or", "implies", *temporal, *temporal])
    first = int(rng.integers(0, LONGEST))
    interval = "" if rng.uniform() < 0.3 else f"[{first}:{int(rng.integers(first, LONGEST + 1))} tick]"
    if word == "not":
        return f"not {inside()}"
    if word in ("and", "or", "implies"):
        return f"{inside()} {word} {inside()}"
    if word in ("since", "until"):
        return f"{inside()} {word}{interval} {inside()}"
    return f"{word}{interval} {inside()}"


def random_requirement(rng: np.random.Generator, depth: int) -> str:
    """One that can be watched while it runs: of always and eventually, of formulas of the past."""
    parts = [f"{rng.choice(['always', 'eventually'])} ({random_formula(rng, depth, past=True)})" for _ in range(2)]
    return f"not ({parts[0]}) {rng.choice(['and', 'or', 'implies'])} ({parts[1]})"


def _sum(rng: np.random.Generator) -> str:
    names = rng.choice(SIGNALS, size=3)
    terms = [f"{rng.uniform(0.1, 3.0):.3f} * {names[0]}", f"abs({names[1]} - {rng.uniform():.2f})",
             f"{rng.uniform(0.0, 1.0):.3f}", str(names[2])]  # fmt: skip
    chosen = [str(term) for term in rng.choice(terms, size=rng.integers(1, 4), replace=False)]
    # A minus before the last term alone: RTAMT takes a - b + c for a - (b + c).
    return " + ".join(chosen[:-1]) + f" {rng.choice(['+', '-'])} " * (len(chosen) > 1) + chosen[-1]


def random_run(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """2 to 40 ticks of each signal (RTAMT takes no fewer); some values come again."""
    n = int(rng.integers(2, 41))
    return {name: np.where(rng.uniform(size=n) < 0.3, 0.5, rng.normal(size=n)) for name in SIGNALS}


def by_rtamt(formula: str, signals: dict[str, np.ndarray]) -> np.ndarray:
    """(n,) what RTAMT makes of it."""
    import rtamt

    specification = rtamt.StlDiscreteTimeSpecification()
    for name in SIGNALS:
        specification.declare_var(name, "float")
    # Its unit is a sampling period; without the brackets its parser calls some sums ambiguous.
    specification.spec = f"({formula.replace(' tick]', ']')})"
    specification.parse()
    n = len(next(iter(signals.values())))
    data = {"time": list(range(n))} | {name: values.tolist() for name, values in signals.items()}
    return np.array([value for _, value in specification.evaluate(data)])
