"""FirstGiven: the second speaks where the first has nothing to say."""

import numpy as np

from systems.first_given import FirstGiven
from tests.systems.system_checks import evaluate


def test_by_rank():
    for first, expected in (([1.0, 2.0], [1.0, 2.0]), ([1.0, np.nan], [3.0, 4.0]), ([np.nan] * 2, [3.0, 4.0])):
        assert evaluate(FirstGiven(2), "given", {"first": first, "second": [3.0, 4.0]}).tolist() == expected
