"""A mailbox keeps the newest, and counts everything that it did not keep."""

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.bus.contract import Arrival, Mailbox
from runtime.bus.memory import key_matches
from runtime.messages import Attachment


def arrival(sequence, gid=b"a" * 16):
    return Arrival("k", str(sequence).encode(), Attachment(sequence, 0, gid), 0)


@given(st.lists(st.integers(1, 40), max_size=60), st.integers(1, 8))
def test_every_message_is_taken_overwritten_or_a_duplicate_and_holes_are_missed(sequences, keep):
    mailbox = Mailbox(keep)
    for sequence in sequences:
        mailbox.put(arrival(sequence))
    taken = [a.attachment.sequence for a in mailbox.take_all()]
    assert len(taken) + mailbox.overwritten == mailbox.received
    assert mailbox.received + mailbox.duplicates == len(sequences)
    assert taken == sorted(set(taken))
    if sequences:
        assert mailbox.received + mailbox.missed == max(sequences) - sequences[0] + 1


def test_two_publishers_of_one_topic_have_their_own_numbers():
    mailbox = Mailbox(8)
    for sequence in (1, 2, 3):
        mailbox.put(arrival(sequence, b"a" * 16))
        mailbox.put(arrival(sequence + 100, b"b" * 16))
    assert (mailbox.received, mailbox.missed, mailbox.duplicates) == (6, 0, 0)


def test_a_publisher_that_starts_again_is_another_and_nothing_is_missed():
    mailbox = Mailbox(8)
    mailbox.put(arrival(500, b"a" * 16))
    mailbox.put(arrival(1, b"b" * 16))
    assert (mailbox.received, mailbox.missed, mailbox.duplicates) == (2, 0, 0)


def test_messages_without_numbers_are_all_kept():
    mailbox = Mailbox(8)
    for _ in range(3):
        mailbox.put(Arrival("k", b"x", None, 0))
    assert (mailbox.received, len(mailbox.take_all())) == (3, 3)


def test_a_flood_of_publishers_does_not_grow_it():
    mailbox = Mailbox(1)
    for number in range(1000):
        mailbox.put(arrival(1, number.to_bytes(16, "little")))
    assert len(mailbox._last) <= 64


def test_a_wait_ends_with_the_message_or_with_its_time():
    mailbox = Mailbox(1)
    assert mailbox.take(0.01) is None
    sender = threading.Thread(target=lambda: mailbox.put(arrival(1)))
    sender.start()
    assert mailbox.take(5.0).attachment.sequence == 1
    sender.join()
    began = time.monotonic()
    assert mailbox.take(0.05) is None
    assert time.monotonic() - began >= 0.04


def test_a_mailbox_that_keeps_nothing_is_a_mistake():
    with pytest.raises(ValueError, match="keep = 0"):
        Mailbox(0)


@pytest.mark.parametrize(
    ("pattern", "key", "covers"),
    [
        ("a/b", "a/b", True),
        ("a/*", "a/b", True),
        ("a/*", "a/b/c", False),
        ("a/**", "a/b/c", True),
        ("a/**", "a", True),
        ("**/c", "a/b/c", True),
        ("**", "@x/a", False),
        ("@x/**", "@x/a/b", True),
        ("@x/*", "@x/@y", False),
        ("*", "@x", False),
    ],
)
def test_key_expressions_cover_what_zenoh_says(pattern, key, covers):
    assert key_matches(pattern, key) is covers
