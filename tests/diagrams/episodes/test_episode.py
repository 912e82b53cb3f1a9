"""An outcome is plain enough for JSON."""

import json
from dataclasses import replace

from tests.diagrams.episode_fakes import OUTCOME


def test_outcome_is_plain_enough_for_json():
    back = json.loads(json.dumps(replace(OUTCOME, void=True, success=None).to_dict()))
    assert (back["can_xy"], back["placed"], back["failure"]) == ([0.5, 0.0], True, None)
    assert (back["void"], back["success"], back["way_home_clear"]) == (True, None, True)
