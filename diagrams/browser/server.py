"""Serves the page of a Run on this machine alone, in one thread with what it runs."""

import asyncio
import logging
import signal
from concurrent.futures import Future, ThreadPoolExecutor

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.server.server import Server
from tornado.ioloop import IOLoop

from diagrams.browser.page import Page
from diagrams.browser.run import Run
from models.errors import InputError

HOST = "127.0.0.1"
ENDS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


class OwnThread(ThreadPoolExecutor):
    """Does at once, in the thread that asks, what it is asked for.

    Bokeh 3.10 answers a page in threads of its loop's executor, but a Session is one thread's, and so are the
    contexts of its renderer.
    """

    def submit(self, fn, /, *args, **kwargs) -> Future:
        done: Future = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except BaseException as error:
            done.set_exception(error)
        return done


def serve(run: Run, port: int, scene_url: str, on_ready) -> None:
    """Serves and runs until Ctrl-C, or another signal of ENDS.

    `scene_url`: of Meshcat; `on_ready`: is told the page's address.

    Raises InputError where the port cannot be had, and what a tick raises.
    """
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    logging.getLogger("tornado").setLevel(logging.ERROR)
    asyncio.set_event_loop(asyncio.new_event_loop())
    loop = IOLoop.current()
    asyncio.get_event_loop().set_default_executor(OwnThread())
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
        # Bokeh 3.10 fails, with nobody to mind, where a page goes while its server does.
        logging.getLogger("tornado").setLevel(logging.CRITICAL)
        server.stop()
    if failures:
        raise failures[0]


def _open(document, run: Run, scene_url: str) -> None:
    Page(document, run, scene_url)
