"""Whatever comes over the wire: the decoder never raises, never hoards, and loses only what was touched."""

import itertools

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.urg04lx.decoder import BUFFER_BYTES, Decoder, Reply, ScanReply
from drivers.urg04lx.information import parse_information, parse_parameters, parse_version
from drivers.urg04lx.protocol import StreamRequest, decode_single, encode_scan

REQUESTS = st.sampled_from(
    [
        StreamRequest(first_step=380, last_step=388),
        StreamRequest(first_step=300, last_step=340, wide=False),
        StreamRequest(cluster=11, skip=1),
        StreamRequest(),
    ]
)
PIECES = [
    b"MD00440725010",
    b"00\n99b\n",
    b"QT\n",
    b"00P\n",
    b"\n\n",
    b"0N90W\n",
    b"MD0380038801000\n99b\n",
    b"V\n0\n",
]
NOISE = st.lists(st.one_of(st.binary(max_size=80), st.sampled_from(PIECES)), max_size=60).map(b"".join)


def cut(data, cuts):
    """Split at arbitrary places."""
    places = sorted({0, len(data), *(place % (len(data) + 1) for place in cuts)})
    return [data[begin:end] for begin, end in itertools.pairwise(places)]


def feed(decoder, chunks):
    """Feed and check the law on the way."""
    replies = []
    for chunk in chunks:
        replies += decoder.feed(chunk)
        assert decoder.pending_bytes <= BUFFER_BYTES
    return replies


def plain(replies):
    """Replies as values that can be compared."""
    return [
        (reply.stamp_ms, reply.values.tolist())
        if isinstance(reply, ScanReply)
        else (reply.echo, reply.status)
        for reply in replies
    ]


@given(REQUESTS, NOISE, st.lists(st.integers(0, 10_000), max_size=20))
@settings(max_examples=300, deadline=None)
def test_any_bytes_in_any_chunks_never_raise_and_never_pile_up(request_, noise, cuts):
    decoder = Decoder(request_)
    for reply in feed(decoder, cut(noise, cuts)):
        assert isinstance(reply, ScanReply | Reply)
    assert decoder.skipped_bytes + decoder.pending_bytes <= len(noise)


@given(
    REQUESTS, st.integers(0, 2**24 - 1), st.integers(0, 2**32), st.lists(st.integers(0, 10_000), max_size=30)
)
@settings(max_examples=100, deadline=None)
def test_any_chunking_gives_the_same_scans(request_, stamp_ms, seed, cuts):
    rng = np.random.default_rng(seed)
    scans = [rng.integers(0, 4095, request_.count) for _ in range(3)]
    data = b"".join(encode_scan(request_.echo(0), b"99", stamp_ms, scan, request_.width) for scan in scans)
    chunked = plain(feed(Decoder(request_), cut(data, cuts)))
    assert chunked == [(stamp_ms, scan.tolist()) for scan in scans]


@given(REQUESTS, NOISE, st.lists(st.integers(0, 10_000), max_size=20))
@settings(max_examples=200, deadline=None)
def test_noise_before_good_scans_costs_none_that_it_does_not_touch(request_, noise, cuts):
    good = [
        encode_scan(request_.echo(0), b"99", stamp, [1000] * request_.count, request_.width)
        for stamp in (1, 2)
    ]
    # An empty line ends whatever the noise began, so that it touches nothing behind it.
    data = noise + b"\n\n" + b"".join(good)
    found = plain(feed(Decoder(request_), cut(data, cuts)))
    assert found[-2:] == [(1, [1000] * request_.count), (2, [1000] * request_.count)]


@given(REQUESTS, st.integers(0, 5000), st.binary(min_size=1, max_size=3), st.integers(0, 4))
@settings(max_examples=300, deadline=None)
def test_damage_inside_one_scan_never_gives_wrong_values_and_spares_the_neighbours(request_, at, new, lost):
    scans = [
        encode_scan(request_.echo(0), b"99", stamp, np.arange(request_.count) + 20, request_.width)
        for stamp in (1, 2, 3)
    ]
    # Not the end of the middle scan: losing that is damage to the border.
    place = at % (len(scans[1]) - 10)
    # Six bits of a sum are all that vouches for a line: damage that keeps it cannot be seen by anybody.
    assume(sum(new) % 64 != sum(scans[1][place : place + lost]) % 64)
    middle = scans[1][:place] + new + scans[1][place + lost :]
    found = plain(feed(Decoder(request_), [scans[0] + middle + scans[2]]))
    expected = (np.arange(request_.count) + 20).tolist()
    for stamp in (1, 3):
        assert (stamp, expected) in found
    assert all(value[1] == expected for value in found if not isinstance(value[0], bytes) and value[0] == 2)


@given(st.lists(st.binary(max_size=100), max_size=20))
@settings(max_examples=200, deadline=None)
def test_information_of_any_bytes_is_read_without_raising(lines):
    parse_information(lines)
    parse_version(lines)
    parameters = parse_parameters(lines)
    assert 0 <= parameters.first_step <= parameters.last_step <= 768
    assert decode_single(tuple(lines), 3) is None or all(lines)
