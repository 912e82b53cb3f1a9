"""The page of the faults says what their classes say."""

import re

from diagrams.world.faults.registry import FAULTS
from models.command_line import ROOT


def test_the_page_lists_every_fault_with_what_its_class_says():
    page = (ROOT / "diagrams" / "FAULTS.md").read_text()
    rows = {name: line for name, line in re.findall(r"^(?=\| `(\w+)` \|)(.*)$", page, re.MULTILINE)}
    assert list(rows) == list(FAULTS)
    for name, line in rows.items():
        assert FAULTS[name].severity_1 in line
        assert f"| {FAULTS[name].acts_on} |" in line
        assert (f"subtask {FAULTS[name].subtask}" in line) == bool(FAULTS[name].subtask)
        assert ("to the end" in line) <= FAULTS[name].lasts
