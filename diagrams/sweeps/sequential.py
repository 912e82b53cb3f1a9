"""Two controllers compared while the episodes come in: evidence that may be looked at as often as one likes."""

import numpy as np
from scipy.special import betaln

DECIDED = 20.0  # e at which two controllers are called different: of equal ones at most 1 in 20 ever are
PRIOR = 0.5  # a of the Beta distribution over the share: Jeffreys'


def evidence(wins: int | np.ndarray, discordant: int | np.ndarray, prior: float = PRIOR) -> np.ndarray:
    """e = 2^m B(a + k, a + m - k) / B(a, a) of k `wins` in m `discordant` pairs: where the two did not do the same.

    The likelihood of the sequence under a share drawn from Beta(a, a) over that of a fair coin. Of a fair coin its mean
    is 1 after every pair, given the past: so with equal controllers e exceeds c at any time with a probability of at
    most 1 / c (Ville's inequality; Grünwald, de Heide and Koolen, Safe testing, J. R. Stat. Soc. B 86, 2024), however
    often one looks and whenever one stops. Arrays, or a number each; may be inf. Raises ValueError unless
    0 <= wins <= discordant and prior > 0.
    """
    k, m = np.asarray(wins, float), np.asarray(discordant, float)
    if not (np.all(k >= 0) and np.all(k <= m)) or not prior > 0.0:
        raise ValueError(f"wins {wins} of discordant {discordant} pairs, prior {prior}: 0 <= wins <= discordant needed")
    with np.errstate(over="ignore"):
        return np.exp(m * np.log(2.0) + betaln(prior + k, prior + m - k) - betaln(prior, prior))[()]
