"""Ctrl-C and SIGTERM: a program ends where nothing is lost of what it has finished."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = signal.SIGINT, signal.SIGTERM
ENDED = "interrupted"  # begins the line that says so


class Interrupted(KeyboardInterrupt):
    """The program was asked to end. Its notes say what is kept, and how to go on."""

    def __init__(self, number: int = signal.SIGINT):
        """`number`: of the signal."""
        super().__init__(number)
        self.number = number


class _State:
    """Of this process; signals come to its main thread alone."""

    asked: int | None = None  # number of the signal
    blocks = 0  # of `held`, within each other
    running = False  # a program is in `listening`
    said = False  # one was, and has said that it was asked to end


def asked() -> bool:
    """Whether the program was asked to end; for loops in `held`, in any thread."""
    return _State.asked is not None


@contextmanager
def held() -> Iterator[None]:
    """In the block a first request to end is noted alone: see `asked`; it is raised, as Interrupted, at its end.

    A second one is raised at once. In other threads than the main one, to which no signal comes, it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _State.blocks += 1
    try:
        yield
    finally:
        _State.blocks -= 1
    if not _State.blocks:
        leave_if_asked()


def leave_if_asked() -> None:
    """Raises Interrupted where the program was asked to end, also in a block of `held`; in any thread."""
    if _State.asked is not None:
        raise Interrupted(_State.asked)


def begin() -> None:
    """From here on until `listening`, while Python loads the program, a request to end is obeyed at once, quietly."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # what is ignored stays so, as below nohup
            signal.signal(number, _end)


@contextmanager
def listening() -> Iterator[None]:
    """In the block a request to end is raised as Interrupted; see `held`. A program that is within another's: nothing.

    In another thread than the main one nothing can be done about signals, and nothing is.
    """
    if threading.current_thread() is not threading.main_thread() or _State.running:
        yield
        return
    _State.running, _State.asked = True, None
    before = {n: signal.getsignal(n) for n in SIGNALS if signal.getsignal(n) is not signal.SIG_IGN}
    try:
        for number in before:
            signal.signal(number, _note)
        yield
    finally:
        _State.said = _State.asked is not None
        for number, handler in before.items():
            signal.signal(number, handler)
        _State.running, _State.asked = False, None


def _note(number: int, frame: FrameType | None) -> None:
    again, _State.asked = _State.asked is not None, number
    if again or not _State.blocks:
        raise Interrupted(number)


def _end(number: int, frame: FrameType | None) -> None:
    if sys.stderr is not None and not _State.said:
        os.write(2, f"{ENDED} before it began: start it again\n".encode())
    os._exit(128 + number)
