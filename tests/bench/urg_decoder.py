"""How many scans a second one core decodes, and which damage passes.

python tests/bench/urg_decoder.py [--every-byte]
"""

import argparse
import json
import time

import numpy as np

from drivers.urg04lx.decoder import Decoder, ScanReply
from drivers.urg04lx.protocol import StreamRequest, encode_scan

REQUEST = StreamRequest()
REMAINING = (13, 14)  # two digits that may be anything


def scan(seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    values = np.where(rng.random(682) < 0.5, rng.integers(0, 20, 682), rng.integers(20, 5601, 682))
    return encode_scan(REQUEST.echo(0), b"99", 1000 + 100 * seed, values, 3)


def throughput(chunk_bytes: int, scans: int = 4000) -> float:
    data = b"".join(scan(seed % 50) for seed in range(scans))
    chunks = [data[at : at + chunk_bytes] for at in range(0, len(data), chunk_bytes)]
    decoder = Decoder(REQUEST)
    began = time.process_time()
    found = sum(len(decoder.feed(chunk)) for chunk in chunks)
    took_s = time.process_time() - began
    assert found == scans
    return scans / took_s


def passes(damaged: bytes, good: list[int]) -> bool:
    """Whether a damaged scan is taken for a scan with other values."""
    replies = Decoder(REQUEST).feed(damaged)
    return any(isinstance(reply, ScanReply) and reply.values.tolist() != good for reply in replies)


def undetected() -> dict[str, str]:
    """Try every substitution of every byte, and every lost byte."""
    whole = scan(0)
    (reply,) = Decoder(REQUEST).feed(whole)
    assert isinstance(reply, ScanReply)
    good = reply.values.tolist()
    substituted = lost = passed_substituted = passed_lost = 0
    for at in range(len(whole)):
        if at in REMAINING:
            continue
        lost += 1
        passed_lost += passes(whole[:at] + whole[at + 1 :], good)
        for byte in range(256):
            if byte != whole[at]:
                substituted += 1
                passed_substituted += passes(whole[:at] + bytes((byte,)) + whole[at + 1 :], good)
    return {
        "substitutions that pass": f"{passed_substituted} of {substituted}",
        "lost bytes that pass": f"{passed_lost} of {lost}",
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--every-byte", action="store_true", help="also try every damage to one byte (a minute)"
    )
    every_byte = parser.parse_args().every_byte
    rates = {f"scans/s, {size} bytes a read": round(throughput(size)) for size in (64, 512, 4096)}
    print(json.dumps({"bench": "urg_decoder", **rates, **(undetected() if every_byte else {})}))
