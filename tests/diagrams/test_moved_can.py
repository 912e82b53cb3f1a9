"""A can is moved by 3 to 6 cm while the hand approaches it, nothing else disturbed: it is placed all the same."""

import json

from diagrams import sweep
from diagrams.sweeps.plan import SweepArguments

EPISODES, LEAST = 8, 7


def test_a_moved_can_is_placed(tmp_path):
    asked = SweepArguments(
        episodes=EPISODES, seed=3, purpose="validation", disturbance=["moved"], workers=2, out=tmp_path
    )  # fmt: skip
    assert sweep.main(asked) == 0
    (cell,) = json.loads((tmp_path / "summary.json").read_text())["cells"]
    assert cell["void"] == 0
    assert cell["task"]["n"] == EPISODES
    assert cell["task"]["successes"] >= LEAST, cell["task"]["failures"]
