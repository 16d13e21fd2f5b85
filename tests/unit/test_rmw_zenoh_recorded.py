"""Our keys, tokens, payloads and attachments beside those that rmw_zenoh itself was seen to make.

*Design*: the examples of `docs/design.md` in github.com/ros2/rmw_zenoh (jazzy, rolling), of nodes `talker`
and `listener` of demo_nodes_cpp. *Test bed*: what a program of the roslibrust project (ROS for Rust) notes in
its comments, seen while `ros2 topic pub /chatter std_msgs/msg/String 'data: Hello World'` and `ros2 topic
echo` ran over rmw_zenoh. *Lyrical*: a token captured off a camera node, from the tests of a graph viewer.
"""

from runtime import messages
from runtime.messages import Attachment, Endpoint

STRING = "std_msgs/msg/String"
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TYPE = f"std_msgs::msg::dds_::String_/{HASH}"

# Design, with ROS_DOMAIN_ID=2.
LISTENER = "aac3178e146ba6f1fc6e6a4085e77f21"
TALKER = "8b20917502ee955ac4476e0266340d5c"
NODE = f"@ros2_lv/2/{LISTENER}/0/0/NN/%/%/listener"
SUBSCRIPTION = f"@ros2_lv/2/{LISTENER}/0/10/MS/%/%/listener/%chatter/{TYPE}/::,10:,:,:,,"
PUBLISHER = f"@ros2_lv/2/{TALKER}/0/10/MP/%/%/talker/%chatter/{TYPE}/::,7:,:,:,,"

# Test bed.
ECHO = "22363ddafe5dc19901b95b42cce0393b"
ECHO_NODE = f"@ros2_lv/0/{ECHO}/0/0/NN/%/%/_ros2cli_1106"
ECHO_SUBSCRIPTION = f"@ros2_lv/0/{ECHO}/0/4/MS/%/%/_ros2cli_1106/%chatter/{TYPE}/::,5:,:,:,,"
KEY = f"0/chatter/{TYPE}"
PAYLOAD = bytes.fromhex("00010000 0c000000 48656c6c 6f20576f 726c6400")
ATTACHMENT = bytes.fromhex("0400000000000000 e3e2c2cf003e6218 10 c63a35bee987062d540cb3f1641c0ef2")
ZENOH_TIME = 7546407767727260256
"""Of the same sample: seconds since 1970, times 2 to the 32nd."""

# Lyrical, which says more behind the quality of service.
LYRICAL = (
    "@ros2_lv/1/a1b2c3d4e5f60718293a4b5c6d7e8f90/6/17/MP/%/%playback/cam_ros2_bridge/%playback%image_raw/"
    f"sensor_msgs::msg::dds_::Image_/{HASH}/2::,5:,:,:,,/backends:cpu:"
)


def test_our_tokens_are_those_of_rmw_zenoh():
    assert messages.node_token(LISTENER, "", "listener", domain=2) == NODE
    assert messages.node_token(ECHO, "", "_ros2cli_1106") == ECHO_NODE
    for token, zid, entity, kind, node, depth, domain in (
        (SUBSCRIPTION, LISTENER, 10, "MS", "listener", 10, 2),
        (PUBLISHER, TALKER, 10, "MP", "talker", 7, 2),
        (ECHO_SUBSCRIPTION, ECHO, 4, "MS", "_ros2cli_1106", 5, 0),
    ):
        quality = messages.qos_text(latched=False, depth=depth)
        assert token == messages.endpoint_token(
            zid, entity, kind, "", node, "chatter", STRING, quality, domain
        )


def test_the_tokens_of_rmw_zenoh_are_read():
    assert messages.node_of_token(NODE) == "listener"
    assert messages.endpoints_of([NODE, SUBSCRIPTION, PUBLISHER]) == [
        Endpoint("MS", "listener", "chatter", STRING, HASH),
        Endpoint("MP", "talker", "chatter", STRING, HASH),
    ]


def test_a_token_that_says_more_than_we_know_is_read_all_the_same():
    (camera,) = messages.endpoints_of([LYRICAL])
    assert (camera.node, camera.topic) == ("cam_ros2_bridge", "playback/image_raw")
    assert camera.type == "sensor_msgs/msg/Image"


def test_our_key_is_that_of_rmw_zenoh():
    assert messages.topic_key("/chatter", STRING) == KEY
    assert messages.endpoints_of([PUBLISHER])[0].key(domain=0) == KEY


def test_our_payload_is_that_of_rmw_zenoh():
    assert messages.encode(messages.TYPES.types[STRING](data="Hello World")) == PAYLOAD
    assert messages.decode(PAYLOAD, STRING).data == "Hello World"


def test_the_attachment_of_rmw_zenoh_is_read_and_would_be_written():
    read = Attachment.decode(ATTACHMENT)
    assert read.sequence == 4
    assert abs(read.published_ns / 1e9 - ZENOH_TIME / 2**32) < 0.1
    assert read.encode() == ATTACHMENT
