"""What is written of an episode for the explorer."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from diagrams.monitors.traces import LEAST, kept_trace, pictures_file, require_same_run, spans, trace_script
from models.errors import InputError
from tests.diagrams.bench_fakes import shown


@pytest.mark.parametrize(
    ("active", "found"),
    [
        ([], []),
        ([False, False], []),
        ([True, True, False], [[0, 2]]),
        ([False, True, False, True, True], [[1, 2], [3, 5]]),
    ],
)
def test_spans(active, found):
    assert spans(active) == found


def test_a_script_calls_the_page_with_rounded_numbers(tmp_path):
    record, acting = shown(60, True)
    scores = {"recall": np.r_[0.0, 1234.5678, np.full(58, 0.12345)]}
    script = trace_script("off-lstm-0-A-1", record, acting, scores, np.full(60, 2.0 / 3.0))
    text = script.decode()
    assert text.startswith('episode("off-lstm-0-A-1", {')
    trace = json.loads(text[len('episode("off-lstm-0-A-1", ') : -len(");\n")])
    assert trace["scores"]["recall"][:3] == [LEAST, 1230.0, 0.123]
    assert trace["alpha"] == [0.667] * 60
    assert (trace["ticks"], trace["acting"]) == (60, [[20, 60]])
    assert trace["pictures"] == {"count": 12, "columns": 10, "every": 5}
    require_same_run(script, record, tmp_path, "KEY")
    record.alpha[3] = 1e-9
    with pytest.raises(InputError, match="KEY runs otherwise now than in "):
        require_same_run(script, record, tmp_path, "KEY")
    with pytest.raises(InputError, match=r"there is no .*KEY\.js: run the command of the bench again"):
        kept_trace(tmp_path, "KEY")


def test_pictures_stand_line_by_line():
    record, _ = shown(60, False)
    sheet = np.asarray(Image.open(io.BytesIO(pictures_file(record))))
    assert sheet.shape == (2 * 112, 10 * 112, 3)
    middle = sheet[56::112, 56::112, 0].ravel()
    assert middle[:12] == pytest.approx(4 * record.picture_ticks, abs=3)  # each of its own grey
    assert not middle[12:].any()
