"""A signal during `held` is noted and ends nothing; once one has come, further ones are ignored."""

import os
import signal

import pytest

from aoabench.cli.stopping import held


@pytest.fixture(autouse=True)
def usual_handler():
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    others = {n: signal.getsignal(getattr(signal, n)) for n in names}
    signal.signal(signal.SIGTERM, lambda *_: pytest.fail("the signal ended something"))
    yield
    for name, handler in others.items():
        signal.signal(getattr(signal, name), handler)


def test_a_signal_is_noted_and_the_next_one_does_not_disturb_the_end():
    with held() as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.number == signal.SIGTERM
        assert os.read(stop.wake, 1) == b"x"
    os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_IGN


def test_without_a_signal_the_handlers_are_put_back():
    before = signal.getsignal(signal.SIGTERM)
    with held() as stop:
        assert signal.getsignal(signal.SIGTERM) != before
    assert stop.number is None
    assert signal.getsignal(signal.SIGTERM) == before
