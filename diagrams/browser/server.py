"""Serves the page of a Run on this machine alone, in one thread with what it runs."""

import asyncio
import logging
import signal

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.server.server import Server
from tornado.ioloop import IOLoop

from diagrams.browser.page import Page
from diagrams.browser.run import Run
from models.errors import InputError

HOST = "127.0.0.1"
ENDS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


def serve(run: Run, port: int, scene_url: str, on_ready) -> None:
    """Serves and runs until Ctrl-C, or another signal of ENDS.

    `scene_url`: of Meshcat; `on_ready`: is told the page's address.

    Raises InputError where the port cannot be had, and what a tick raises.
    """
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    logging.getLogger("tornado").setLevel(logging.ERROR)
    asyncio.set_event_loop(asyncio.new_event_loop())
    loop = IOLoop.current()
    application = Application(FunctionHandler(lambda document: _open(document, run, scene_url)))
    try:
        server = Server(
            {"/": application}, io_loop=loop, port=port, address=HOST,
            allow_websocket_origin=[f"{name}:{port}" for name in (HOST, "localhost")],
        )  # fmt: skip
    except OSError as error:
        raise InputError(
            f"the page cannot be served at port {port} ({error.strerror}): choose another --port"
        ) from error
    failures: list[BaseException] = []

    def work() -> None:
        try:
            loop.call_later(run.work(), work)
        except BaseException as error:
            failures.append(error)
            loop.stop()

    # What is ignored stays so, as SIGHUP below nohup.
    ends = [each for each in ENDS if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, lambda *_: loop.add_callback_from_signal(loop.stop)) for each in ends}
    try:
        server.start()
        loop.add_callback(work)
        loop.add_callback(on_ready, f"http://localhost:{port}/")
        loop.start()
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        server.stop()
    if failures:
        raise failures[0]


def _open(document, run: Run, scene_url: str) -> None:
    Page(document, run, scene_url)
