import os
import signal

import pytest

from runtime.cli.stopping import asked_to_stop, insisting


def test_signals_are_collected_and_then_do_again_what_they_did():
    before = signal.getsignal(signal.SIGINT)
    heard = []
    with asked_to_stop(lambda asked: heard.append(len(asked))) as asked:
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), number)
    assert asked == [signal.SIGINT, signal.SIGTERM]
    assert heard == [1, 2]
    assert signal.getsignal(signal.SIGINT) is before


def test_who_insists_ends_at_once():
    with asked_to_stop(insisting(2)) as asked:
        os.kill(os.getpid(), signal.SIGINT)
        assert asked == [signal.SIGINT]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
