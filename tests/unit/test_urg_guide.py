"""The guide on adding a lidar: its code runs, and what it names exists."""

import re
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs" / "adding-a-lidar.md"


def test_the_codec_of_the_guide_keeps_its_own_three_laws(tmp_path):
    code = "\n".join(
        textwrap.dedent(block) for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.S)
    )
    names = {"__name__": "guide"}
    exec(compile(code, str(GUIDE), "exec"), names)
    names["test_a_packet_is_read_whole_byte_by_byte_and_between_neighbours"]()
    decoder, encode, packet = names["Decoder"](), names["encode"], names["Packet"]
    data = encode(packet(1, (1,) * 8))
    assert decoder.feed(b"\xff" * 1000 + data[:5], 10) == []
    assert len(decoder._buffer) < 30
    assert len(decoder._arrivals) <= 2
    assert [p.at_ns for p in decoder.feed(data[5:] + data, 20)] == [10, 20]


def test_every_file_the_guide_names_exists():
    named = re.findall(r"`((?:drivers|runtime|tests|docs)/[\w/*.]+)", GUIDE.read_text())
    assert len(named) > 8
    for name in named:
        assert list(ROOT.glob(name)), name
    for name in ("sensor.py", "wire.py", "watch.py", "clockmap.py", "60-hallway-urg.rules"):
        assert (ROOT / "drivers" / "urg04lx" / name).exists()
