"""`hallway topic` on any key of the bus: what its publisher's token says counts, our table only fills in."""

import threading

import numpy as np
import pytest
import yaml

from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.cli import main
from runtime.clock import Clock
from runtime.messages import Attachment
from runtime.nodes.convert import pose_to_message

STRING = messages.TYPES.types["std_msgs/msg/String"]


@pytest.fixture
def bus(monkeypatch):
    """The bus that the command comes to."""
    session = MemoryBus()
    monkeypatch.setattr("runtime.access.gate.visit", lambda robot: {})
    monkeypatch.setattr("runtime.bus.zenoh_bus.ZenohBus", lambda config: session.join())
    return session


class Talker:
    """A process that declares one topic and says the same message ten times a second."""

    def __init__(self, bus, topic, message, *, latched=False, hashed="", delay_ns=0):
        self.message, self.delay_ns = message, delay_ns
        msgtype = message.__msgtype__
        quality = messages.qos_text(latched=latched, depth=1)
        token = messages.endpoint_token(bus.zid, 1, "MP", "", "talker", topic, msgtype, quality)
        if hashed:
            token = token.replace(messages.type_hash(msgtype), hashed)
        bus.token(token)
        key = messages.endpoints_of([token])[0].key()
        self.publisher, self.sequence, self.stop = bus.publisher(key, latched=latched), 0, threading.Event()
        self.thread = threading.Thread(target=self._talk)

    def say(self):
        self.sequence += 1
        if self.delay_ns:
            self.message.header = messages.header(Clock().now_ns() - self.delay_ns, "map")
        self.publisher.put(messages.encode(self.message), Attachment(self.sequence, 0, bytes(16)).encode())

    def _talk(self):
        while not self.stop.wait(0.1):
            self.say()

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join()


def pose():
    return messages.PoseStamped(messages.header(5, "map"), pose_to_message(np.array([1.0, 2.0, 0.0])))


def test_a_topic_that_we_never_heard_of_is_echoed_by_what_its_token_says(bus, capsys):
    Talker(bus, "chatter", STRING(data="Hello World"), latched=True).say()
    assert main(["topic", "echo", "/chatter", "-n", "1"]) == 0
    assert capsys.readouterr().out == 'data: "Hello World"\n---\n'


def test_a_long_array_is_echoed_in_whole_if_asked(bus, capsys):
    size = 200
    update = messages.OccupancyGridUpdate(
        header=messages.header(5, "map"), x=0, y=0, width=size, height=1, data=np.zeros(size, np.int8)
    )
    Talker(bus, "robot/map_updates", update, latched=True).say()
    assert main(["topic", "echo", "map_updates", "-n", "1"]) == 0
    assert "0, ...]" in capsys.readouterr().out
    assert main(["topic", "echo", "map_updates", "-n", "1", "--full"]) == 0
    assert len(yaml.safe_load(capsys.readouterr().out.removesuffix("---\n"))["data"]) == size


def test_a_name_of_ours_may_have_another_type_than_our_table_says(bus, capsys):
    Talker(bus, "robot/pose", pose(), latched=True).say()
    assert main(["topic", "echo", "pose", "-n", "1"]) == 0
    read = yaml.safe_load(capsys.readouterr().out.removesuffix("---\n"))
    assert read["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}


def test_the_delay_is_the_age_of_the_stamp(bus, capsys):
    with Talker(bus, "other/pose", pose(), delay_ns=3_000_000_000):
        assert main(["topic", "delay", "other/pose", "-n", "5"]) == 0
    words = capsys.readouterr().out.splitlines()[-1].replace(",", "").split()
    assert words[0] == "p50"
    assert 3000 <= float(words[1]) < 4000
    assert words[-2:] == ["5", "messages"]


def test_what_has_no_stamp_has_no_delay(bus, capsys):
    Talker(bus, "robot/tf", messages.TFMessage(transforms=[]))
    assert main(["topic", "delay", "tf"]) == 2
    assert "robot/tf: tf2_msgs/msg/TFMessage has no header, and so no stamp" in capsys.readouterr().err


def test_of_another_definition_only_the_rate_is_told(bus, capsys):
    with Talker(bus, "odd", STRING(data=""), hashed="RIHS01_00"):
        assert main(["topic", "echo", "odd"]) == 2
        assert (
            "odd: std_msgs/msg/String RIHS01_00 is not known here; only hz works" in capsys.readouterr().err
        )
        assert main(["topic", "hz", "odd", "-n", "5"]) == 0
    rate = float(capsys.readouterr().out.split(" Hz")[0].split()[-1])
    assert 2 < rate < 20


def test_a_topic_of_ours_may_be_waited_for(bus, capsys):
    assert main(["topic", "hz", "scan", "--within", "0.1"]) == 1
    assert capsys.readouterr().out == "no rate yet, 0 messages\n"


def test_a_topic_that_nobody_has_is_named(bus, capsys):
    assert main(["topic", "echo", "scam"]) == 2
    assert "topic 'scam': unknown; did you mean 'scan'?" in capsys.readouterr().err


def test_the_list_has_foreign_topics_too(bus, capsys):
    Talker(bus, "chatter", STRING(data=""))
    assert main(["topic", "list"]) == 0
    assert capsys.readouterr().out.split() == ["chatter", "std_msgs/msg/String", "talker", "->", "nobody"]
