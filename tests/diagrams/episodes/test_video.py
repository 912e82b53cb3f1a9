"""The video of a run: whole, or said not to be."""

import subprocess
import sys

import cv2
import numpy as np
import pytest

from diagrams.episodes.video import save_video
from models.command_line import ROOT


class Writer:
    """Drake's, as far as it is used; its frames are in `path`."""

    def __init__(self, path, frames):
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10.0, (64, 48))
        for number in range(frames):
            self._writer.write(np.full((48, 64, 3), 9 * number, np.uint8))

    def Save(self):
        self._writer.release()


def test_a_whole_video_gets_its_name(tmp_path):
    made, path = tmp_path / "x.part.mp4", tmp_path / "x.mp4"
    save_video(Writer(made, 12), made, 12, path)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert not made.exists()


@pytest.mark.parametrize("cut", [0, 200, -100])
def test_one_that_is_not_whole_is_refused(tmp_path, cut):
    made, path = tmp_path / "x.part.mp4", tmp_path / "x.mp4"
    writer = Writer(made, 12)

    def save():
        Writer.Save(writer)
        with made.open("rb+") as file:
            file.truncate(cut % made.stat().st_size)  # as on a full disk

    writer.Save = save
    with pytest.raises(OSError, match="of 12 frames arrived") as refused:
        save_video(writer, made, 12, path)
    assert refused.value.filename == str(path)
    assert not path.exists()


def test_lost_frames_are_not_told_one_by_one(tmp_path):
    code = """
import resource, sys
import cv2, numpy as np
import diagrams.episodes.video
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
writer = cv2.VideoWriter(sys.argv[1], cv2.VideoWriter_fourcc(*"mp4v"), 10, (640, 480))
frame = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
for _ in range(5):
    writer.write(frame)
"""
    words = [sys.executable, "-c", code, str(tmp_path / "v.mp4")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "v.mp4").stat().st_size == 20_000
