"""Frames a second that the decoder of the Create's stream reads on one core.

`python tests/bench/create_decoder.py`: good frames, and frames of which every twentieth is damaged, in chunks
of one frame. The robot sends 66.7 a second.
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from drivers.create import stream

FRAMES = 20_000


def rate(wire, size):
    """Return frames a second of CPU time."""
    decoder = stream.StreamDecoder()
    began = time.process_time()
    for at in range(0, len(wire), size):
        decoder.feed(wire[at : at + size])
    return decoder.frames / (time.process_time() - began), decoder


def main():
    values = {7: 0, 22: 15_000, 23: -500, 24: 25, 25: 2000, 26: 2700, 35: 2, 41: 200, 42: 150}
    good = stream.encode_frame(stream.PACKETS, values)
    damaged = bytearray(good * FRAMES)
    damaged[10 :: 20 * len(good)] = bytes(len(damaged[10 :: 20 * len(good)]))
    results = {}
    for name, wire in (("good", good * FRAMES), ("damaged", bytes(damaged))):
        found, decoder = rate(wire, len(good))
        results[name] = {"frames_per_s": round(found), "us_per_frame": round(1e6 / found, 1)}
        print(f"{name:8} {found:8.0f} frames/s, {1e6 / found:6.1f} us each; {decoder.counters()}")
    print(json.dumps({"bench": "create_decoder", **results}))


if __name__ == "__main__":
    main()
