"""Calls that one thread carries out in turn while the command goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from types import TracebackType
from typing import TypeVar

T = TypeVar("T")
_PATIENCE_S = 5.0  # for the call in progress, once the command has failed or was interrupted


class Background:
    """A context with one thread, which carries out the calls handed to `submit` in their order.

    At its end, all calls are done; after an exception in the context, those that have not begun are
    left out.
    """

    def __init__(self) -> None:
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._given_up = threading.Event()
        # a daemon: an interrupted command must not wait for it
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)

    def __enter__(self) -> Background:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._calls.put(None)
        if error is not None:
            self._given_up.set()
        self._thread.join(None if error is None else _PATIENCE_S)

    def submit(self, call: Callable[[], T]) -> Future[T]:
        """Have a call carried out after those before it; the future has its result or its
        exception.
        """
        future: Future[T] = Future()

        def carry_out() -> None:
            try:
                future.set_result(call())
            except BaseException as error:  # raised where the result is asked for
                future.set_exception(error)

        self._calls.put(carry_out)
        return future

    def _work(self) -> None:
        while (call := self._calls.get()) is not None and not self._given_up.is_set():
            call()
