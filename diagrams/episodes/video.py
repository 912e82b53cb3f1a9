"""The video of a run: Drake's writer says nothing where a frame could not be written."""

import errno
import os
from pathlib import Path

import cv2

# It warns of each lost frame; here it is said once. OpenCV 5 has this elsewhere.
(cv2.utils.logging if hasattr(cv2.utils, "logging") else cv2).setLogLevel(0)


def save_video(writer, made: Path, frames: int, path: Path) -> None:
    """Ends Drake's VideoWriter `writer`, whose file `made` becomes `path`.

    Raises OSError where that does not hold `frames` frames that can be read.
    """
    writer.Save()
    reader = cv2.VideoCapture(str(made))
    try:
        count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.set(cv2.CAP_PROP_POS_FRAMES, count - 1)
        if count < frames or not reader.read()[0]:
            raise OSError(errno.EIO, f"{count} of {frames} frames arrived", str(path))
    finally:
        reader.release()
    os.replace(made, path)
