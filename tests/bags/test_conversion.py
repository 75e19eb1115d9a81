"""Bags of one generation of ROS become bags of the other as `rosbags-convert` writes them."""

import io
import subprocess
import sys

import numpy as np
import pytest
from oracles import FIXTURES, OFFICE, OFFICE_BAG, OFFICE_MCAP, mcap_messages, rewritten, ros1_messages
from rosbags.convert.converter import convert as rosbags_convert
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.rosbag2 import Reader as Ros2LibraryReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from odomcorrupt.bags.block import Channel, Definition
from odomcorrupt.bags.convert.message_types import convert_type, latched_qos, stays_for_late_subscribers
from odomcorrupt.bags.convert.reader import split_edge, without_edges
from odomcorrupt.bags.definition import md5sum_of, retyped, ros_type, with_common_text
from odomcorrupt.bags.open import open_reader, target_of
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError, TopicError
from rosmessages import STORES, edge, serialised, tree

NOETIC, HUMBLE = STORES[1], STORES[2]
ROS2_NAMES = [".mcap", ".db3", ""]
NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return two seconds of the office as a ROS 2 directory and as a ROS 1 bag, written by the rosbags library."""
    room = tmp_path_factory.mktemp("short")
    writer = Ros2LibraryWriter(room / "two", version=8, storage_plugin=StoragePlugin.SQLITE3)
    rewritten(Ros2LibraryReader(OFFICE), writer, seconds=2)
    foreign(room / "two", room / "one.bag")
    return {1: room / "one.bag", 2: room / "two"}


def foreign(source, target, store=None):
    """Convert a bag by the rosbags library."""
    rosbags_convert([source], target, "sqlite3", 8, None, "file", None, store, (), (), (), ())
    return target


def rows(path):
    """Return topic, type, hash, log time and bytes of every message, as the rosbags library reads them."""
    with AnyReader([path]) as reader:
        return sorted((c.topic, c.msgtype, c.digest, log_ns, bytes(data)) for c, log_ns, data in reader.messages())


def numbers(path):
    """Return every message of a bag as text, without the count of ROS 1's headers."""
    with AnyReader([path]) as reader:
        found = []
        for connection, log_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            for part in (message, *getattr(message, "transforms", ())):
                if hasattr(getattr(part, "header", None), "seq"):
                    part.header.seq = 0
            text = repr(message).replace("seq=0, ", "")
            found.append((connection.topic, log_ns, text))
        return sorted(found)


def converted(source, target, **options):
    """Write a bag with its messages converted and nothing else changed."""
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    assert run([str(source), str(target), "--effect", "wheel_scale:e=0", "-q", *words]) == 0
    return target


@pytest.mark.parametrize("name", ROS2_NAMES)
def test_a_ros_1_bag_becomes_the_bag_that_rosbags_makes_of_it(short, name, tmp_path):
    ours = converted(short[1], tmp_path / f"ours{name}")
    theirs = rows(foreign(short[1], tmp_path / "theirs", HUMBLE))
    if name == ".mcap":  # the library reads no hashes from a single one
        theirs = [(topic, msgtype, "", log_ns, data) for topic, msgtype, _, log_ns, data in theirs]
    assert rows(ours) == theirs


@pytest.mark.parametrize("source", ["two", "two.mcap"])
def test_a_ros_2_bag_becomes_the_ros_1_bag_that_rosbags_makes_of_it(short, source, tmp_path):
    bag = short[2] if source == "two" else converted(short[2], tmp_path / source)
    ours = ros1_messages(converted(bag, tmp_path / "ours.bag"))
    theirs = ros1_messages(foreign(short[2], tmp_path / "theirs.bag"))
    assert sorted(one[:1] + one[3:] for one in ours) == sorted(one[:1] + one[3:] for one in theirs)
    assert {(one.topic, one.publisher[1], one.type[1]) for one in ours} == {
        (one.topic, one.publisher[1], one.type[1]) for one in theirs
    }


@pytest.mark.parametrize(("ros", "plain"), [(1, ".bag"), (2, "")])
def test_corruption_is_the_same_whatever_the_output_is(short, ros, plain, tmp_path):
    found = []
    for name in (plain, ".mcap", ".db3", "" if ros == 1 else ".bag"):
        assert run([str(short[ros]), str(tmp_path / f"out{name}"), *NOISE, "-q"]) == 0
        found.append(numbers(tmp_path / f"out{name}"))
    assert found == found[:1] * 4


def test_there_and_back_again_is_the_same_bag(short, tmp_path):
    there = converted(short[2], tmp_path / "there.bag")
    back = converted(there, tmp_path / "back", storage="sqlite3")
    assert rows(back) == rows(short[2])


def test_what_is_added_to_a_converted_bag_is_of_its_kind(short, tmp_path):
    words = ["--keep-truth", "/clean", "--tf", "correction", "--new-odom-frame", "drifting", *NOISE, "-q"]
    for source, name in ((short[1], "out"), (short[2], "out.bag")):
        assert run([str(source), str(tmp_path / name), *words]) == 0
        found = numbers(tmp_path / name)
        clean = [text for topic, _, text in found if topic == "/clean"]
        assert clean == [text for topic, _, text in numbers(source) if topic == "/odom"]
        assert sum("drifting" in text for _, _, text in found) == len(clean)


def test_a_correction_converts_too(short, tmp_path):
    assert run(["correct", str(short[1]), str(tmp_path / "out"), "--effect", "wheel_scale:e=0.05", "-q"]) == 0
    assert {row[1] for row in rows(tmp_path / "out")} == {row[1] for row in rows(short[2])}
    assert run(["correct", str(short[1]), str(tmp_path / "out.bag"), "--effect", "wheel_scale:e=0.05", "-q"]) == 0
    assert numbers(tmp_path / "out") == numbers(tmp_path / "out.bag")


@pytest.mark.parametrize(("kind", "suffix"), [("bag", ".bag"), ("directory", ""), ("db3", ".db3")])
def test_runs_of_a_batch_are_those_of_single_conversions(short, kind, suffix, tmp_path):
    words = ["--runs", "2", "--to", kind, "--exclude-topic", "/imu", *NOISE, "-q"]
    assert run(["batch", str(short[2]), str(tmp_path / "runs"), *words]) == 0
    single = tmp_path / f"run_000001{suffix}"
    assert run([str(short[2]), str(single), "--run", "1", "--exclude-topic", "/imu", *NOISE, "-q"]) == 0
    assert rows(tmp_path / "runs" / single.name) == rows(single)
    other = ["mcap" if word == kind else word for word in words]
    assert run(["batch", str(short[2]), str(tmp_path / "runs"), *other]) == 1


def test_an_overlay_of_another_kind_is_assembled(short, tmp_path):
    assert run(["batch", str(short[1]), str(tmp_path / "runs"), "--runs", "1", "--output", "overlay", *NOISE]) == 0
    for name in ("whole.bag", "whole"):
        overlay = str(tmp_path / "runs" / "run_000000.mcap")
        assert run(["assemble", overlay, "--input", str(short[1]), str(tmp_path / name)]) == 0
    assert run([str(short[1]), str(tmp_path / "single.bag"), *NOISE, "-q"]) == 0
    assert numbers(tmp_path / "whole") == numbers(tmp_path / "whole.bag") == numbers(tmp_path / "single.bag")


@pytest.mark.slow
def test_a_pipe_keeps_the_generation_unless_another_is_asked_for(short, tmp_path):
    bag, found = short[1].read_bytes(), {}
    for ros in ((), ("--ros", "2")):
        words = [sys.executable, "-m", "odomcorrupt", "-", "-", "--odom-topic", "/odom", *NOISE, *ros]
        done = subprocess.run(words, input=bag, capture_output=True, check=True)
        path = tmp_path / f"out{len(ros)}.mcap"
        path.write_bytes(done.stdout)
        found[ros] = {one.publisher[0] for one in mcap_messages(path)}
    assert found == {(): {"ros1"}, ("--ros", "2"): {"cdr"}}
    assert run([str(short[1]), str(tmp_path / "file.mcap"), *NOISE, "-q"]) == 0
    assert numbers(tmp_path / "out2.mcap") == numbers(tmp_path / "file.mcap")
    assert run([str(short[1]), str(tmp_path / "kept.mcap"), "--ros", "1", *NOISE, "-q"]) == 0
    assert {one.publisher[0] for one in mcap_messages(tmp_path / "kept.mcap")} == {"ros1"}


def test_a_ros_1_mcap_on_a_pipe_becomes_a_ros_2_directory(short, tmp_path):
    kept = converted(short[1], tmp_path / "kept.mcap", ros=1)
    with open_reader(None, io.BytesIO(kept.read_bytes())) as piped:
        assert not piped.complete
        output = target_of(tmp_path / "out", piped)
        blocks = [(block.table.copy(), block.data.tobytes()) for block in output.reader.blocks()]
    with open_reader(kept) as whole:
        again = [(b.table.copy(), b.data.tobytes()) for b in target_of(tmp_path / "out", whole).reader.blocks()]
    assert [data for _, data in blocks] == [data for _, data in again]
    assert sum(len(table) for table, _ in blocks) == len(rows(short[2]))


def test_a_topic_that_cannot_be_converted_is_named_with_the_way_out(tmp_path, invoke):
    source = FIXTURES / "incomplete.mcap"
    said = invoke([source, tmp_path / "out.bag", *NOISE], 1).err.strip()
    assert said.count("\n") == 0
    for part in ("/door", "office_msgs/msg/Door: ", "lacks that of office_msgs/msg/DoorState", "--exclude-topic /door"):
        assert part in said
    assert list(tmp_path.iterdir()) == []
    assert run([str(source), str(tmp_path / "out.bag"), "--exclude-topic", "/door", *NOISE, "-q"]) == 0
    assert {one.topic for one in ros1_messages(tmp_path / "out.bag")} == {"/odom", "/tf", "/tf_static", "/imu", "/scan"}
    assert run([str(source), str(tmp_path / "out.mcap"), *NOISE, "-q"]) == 0  # nothing has to be converted here


def test_a_topic_to_leave_out_must_be_there(short, tmp_path, invoke):
    assert "--exclude-topic /dor: " in invoke([short[2], tmp_path / "out", "--exclude-topic", "/dor", *NOISE], 1).err
    assert run([str(short[2]), str(tmp_path / "out.mcap"), "--exclude-topic", "door", *NOISE, "-q"]) == 0
    assert "/door" not in {one.topic for one in mcap_messages(tmp_path / "out.mcap")}


@pytest.mark.parametrize(
    ("name", "words", "said"), [("out.bag", ("--ros", "2"), "a ROS 1 bag holds messages of ROS 1, not of ROS 2"),
    ("out", ("--ros", "1"), "a directory holds messages of ROS 2, not of ROS 1"),
    ("out.mcap", ("--storage", "sqlite3"), "--storage sqlite3 is for directories"),
    ("out.bag", ("--compression", "message"), "compression message: is not available for a ROS 1 bag")]
)  # fmt: skip
def test_what_a_format_cannot_have_is_refused(short, name, words, said, tmp_path, invoke):
    assert said in invoke([short[1], tmp_path / name, *words, *NOISE], 1).err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["out.mcap", "-"])
def test_messages_of_ros_2_do_not_become_an_mcap_of_ros_1_which_few_programs_read(short, name, tmp_path, invoke):
    output = name if name == "-" else str(tmp_path / name)
    said = invoke([short[2], output, "--ros", "1", "--exclude-topic", "/door", *NOISE], 1)
    assert "which rosbags-convert and rosbag refuse to read; end the name in .bag for ROS 1" in said.err
    assert said.out == ""
    assert list(tmp_path.iterdir()) == []


def test_common_types_have_the_md5sums_of_ros_1_and_the_hashes_of_ros_2():
    names = ["nav_msgs/msg/Odometry", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2",
             "visualization_msgs/msg/Marker", "diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/Header",
             "trajectory_msgs/msg/JointTrajectory", "nav_msgs/msg/OccupancyGrid"]  # fmt: skip
    for name in names:
        text, _ = HUMBLE.generate_msgdef(name, ros_version=2)
        assert (
            convert_type(name, Definition(name, "ros2msg", text.encode(), {}), 1).digest
            == (NOETIC.generate_msgdef(name, ros_version=1)[1])
        )
        text, _ = NOETIC.generate_msgdef(name, ros_version=1)
        assert convert_type(name, Definition(name, "ros1msg", text.encode(), {}), 2).digest == HUMBLE.hash_rihs01(name)


def test_a_type_of_ones_own_keeps_its_fields_and_loses_limits_that_ros_1_does_not_know():
    text = "std_msgs/Header header\nstring<=8 name\nfloat64[<=3] values\nbuiltin_interfaces/Time at\n"
    new = convert_type("own_msgs/msg/Own", Definition("own_msgs/msg/Own", "ros2msg", text.encode(), {}), 1)
    assert new.text.startswith("std_msgs/Header header\nstring name\nfloat64[] values\ntime at\n")
    assert new.digest == md5sum_of("own_msgs/msg/Own", Definition("own_msgs/Own", "ros1msg", new.text.encode(), {}))
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, "own_msgs/msg/Own"))
    time = store.types["builtin_interfaces/msg/Time"](3, 4)
    header = store.types["std_msgs/msg/Header"](time, "map")
    message = store.types["own_msgs/msg/Own"](header, "left", np.array([1.0, 2.0]), time)
    for little in (True, False):
        data = store.serialize_cdr(message, "own_msgs/msg/Own", little_endian=little)
        out = bytes(new.convert(memoryview(bytes(data))))
        assert out[4:12] == b"\3\0\0\0\4\0\0\0"
        assert out[-8:] == b"\3\0\0\0\4\0\0\0"
        assert out[19:27] == b"\4\0\0\0left"


def test_fields_that_the_other_ros_does_not_have_are_lost_and_named():
    name = "visualization_msgs/msg/Marker"
    text, _ = HUMBLE.generate_msgdef(name, ros_version=2)
    new = convert_type(name, Definition(name, "ros2msg", text.encode(), {}), 1)
    assert new.lost == ("texture_resource", "texture", "uv_coordinates", "mesh_file")
    text, _ = NOETIC.generate_msgdef(name, ros_version=1)
    back = convert_type(name, Definition(name, "ros1msg", text.encode(), {}), 2)
    assert back.lost == ()


@pytest.mark.parametrize(
    ("msgtype", "text", "said"), [("a_msgs/msg/A", "a_msgs/B b\n", "its definition lacks that of a_msgs/msg/B"),
    ("a_msgs/msg/A", "a_msgs/A a\n", "a_msgs/msg/A contains itself"),
    ("a_msgs/msg/A", "std_msgs/Empty[1000000000] a\n", "arrays of fixed length are too long"),
    ("a_msgs/msg/A", "string[1000000000] a\n", "arrays of fixed length are too long"),
    ("a_msgs/msg/A\nimport os", "int8 a\n", "is not a message type"),
    ("a_msgs/msg/A", "wstring a\n", "lacks that of a_msgs/msg/wstring"),
    ("a_msgs/msg/A", "int8 a\n" * 200_000, "characters, which no recorder writes"),
    ("a_msgs/action/A", "int8 a\n", "services and actions have no counterpart"),
    ("a_msgs/msg/A", "nonsense ===\n", "Could not parse")]
)  # fmt: skip
def test_a_definition_that_cannot_be_used_is_refused_quickly(msgtype, text, said):
    with pytest.raises(BagError, match=said.replace("[", r"\[")) as caught:
        convert_type(msgtype, Definition(msgtype, "ros2msg", text.encode(), {}), 1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\7\0\0" + bytes(12), bytes(50)])
def test_a_message_that_is_not_of_its_type_is_refused(data):
    text = b"std_msgs/Empty[] nothing\nstring name\n"
    new = convert_type("a_msgs/msg/A", Definition("a_msgs/msg/A", "ros2msg", text, {}), 1)
    with pytest.raises(BagError, match="a_msgs/msg/A: a message of"):
        new.convert(memoryview(data))


def test_a_damaged_bag_is_saved_without_the_messages_that_are_not_of_their_type(tmp_path, invoke):
    source = tmp_path / "in.bag"
    odometry = next(one.data for one in ros1_messages(FIXTURES / "office.bag") if one.topic == "/odom")
    with Ros1LibraryWriter(source) as writer:
        odom = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=NOETIC)
        name = writer.add_connection("/name", "std_msgs/msg/String", typestore=NOETIC)
        for number in range(20):
            writer.write(odom, 10**18 + number, odometry)
        writer.write(name, 10**18 + 30, b"\xff\xff\xff\xffno")
    assert "/name cannot become messages of ROS 2" in invoke([source, tmp_path / "out.mcap", *NOISE], 1).err
    assert run([str(source), str(tmp_path / "out.mcap"), "--recover", *NOISE]) == 3
    assert {row[0] for row in rows(tmp_path / "out.mcap")} == {"/odom"}


def test_latching_is_transient_local():
    assert stays_for_late_subscribers(latched_qos())
    assert stays_for_late_subscribers("- durability: transient_local")
    for other in ("", "- durability: 2", "- durability: volatile", "nonsense: [", "- 3", "durability: 1"):
        assert not stays_for_late_subscribers(other)


def test_publishers_of_one_topic_become_one_topic(tmp_path):
    source = tmp_path / "in.bag"
    with Ros1LibraryWriter(source) as writer:
        made = [
            writer.add_connection("/s", "std_msgs/msg/String", typestore=NOETIC, callerid=f"/{n}", latching=n)
            for n in (0, 1)
        ]
        for number, one in enumerate(made * 2):
            writer.write(one, 10**18 + number, b"\2\0\0\0hi")
    with open_reader(source) as reader:
        output = target_of(tmp_path / "out", reader)
        (channel,) = output.reader.channels.values()
        assert sum(len(block.table) for block in output.reader.blocks()) == 4
        assert stays_for_late_subscribers(output.reader.definition(channel).metadata["offered_qos_profiles"])


TF = "tf2_msgs/msg/TFMessage"


def of_edges(encoding, edges, order):
    """Return a message of TF whose transforms are numbered, in their stamps and places."""
    ros, turn = 1 if encoding == "ros1" else 2, (0.0, 0.0, 0.6, 0.8)
    rows = ((n * (10**9 + 1) + 5 * 10**9, *names, (n, 2.0, 3.0), turn) for n, names in enumerate(edges))
    return serialised(ros, tree(ros, *(edge(ros, *row) for row in rows)), little=order == "little")


@pytest.mark.parametrize(("encoding", "order"), [("ros1", "little"), ("cdr", "little"), ("cdr", "big")])
def test_a_message_without_an_edge_is_the_message_of_the_other_edges(encoding, order):
    rng = np.random.default_rng(3)
    channel = Channel(1, "/tf", TF, encoding)
    for _ in range(60):
        frames = ["f" * int(n) for n in rng.integers(1, 12, 8)]
        edges = [(str(rng.choice(frames)), str(rng.choice(frames))) for _ in range(rng.integers(1, 6))]
        gone = frozenset(edges[i] for i in rng.integers(0, len(edges), rng.integers(1, 3)))
        after = without_edges(of_edges(encoding, edges, order), channel, gone)
        left = [(i, one) for i, one in enumerate(edges) if one not in gone]
        if not left:
            assert after is None
            continue
        # the numbers of a transform are those of its place in the message as it was
        read = STORES[1].deserialize_ros1 if encoding == "ros1" else STORES[2].deserialize_cdr
        edges = read(after, TF).transforms
        found = [(int(t.header.stamp.sec) - 5, (t.header.frame_id, t.child_frame_id)) for t in edges]
        assert found == left
        assert all(t.transform.translation.x == t.header.stamp.sec - 5 for t in read(after, TF).transforms)
        if [i for i, _ in left] == list(range(len(left))):
            assert after.rstrip(b"\0") == of_edges(encoding, [one for _, one in left], order).rstrip(b"\0")
    untouched = of_edges(encoding, [("map", "odom"), ("odom", "base")], order)
    assert without_edges(untouched, channel, frozenset({("odom", "map")})) == untouched


def test_an_edge_may_have_dots_and_must_be_of_tf():
    channels = [Channel(1, "/tf", TF, "cdr"), Channel(2, "/a:b.c", "std_msgs/msg/String", "cdr")]
    assert split_edge("/tf:map.odom", channels) == ("tf", frozenset({("map", "odom")}))
    assert split_edge("tf:a.b./c", channels)[1] == {("a", "b./c"), ("a.b", "c")}
    assert split_edge("/a:b.c", channels) == ("a:b.c", frozenset())
    assert split_edge("/tf:map.odom", None) == ("tf", frozenset({("map", "odom")}))
    for wrong in ("/tf:map", "/no:map.odom", "/no"):
        with pytest.raises(TopicError, match="name one of these"):
            split_edge(wrong, channels)


MD5SUMS = {  # as rosmsg prints them
    "nav_msgs/msg/Odometry": "cd5e73d190d741a2f92e81eda573aca7",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "tf/msg/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "geometry_msgs/msg/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
}
HASHES = {  # as ros2 topic info prints them
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}


def test_types_have_the_md5sums_and_hashes_of_ros():
    for msgtype, md5sum in MD5SUMS.items():
        kind = ros_type(msgtype, "ros1")
        assert (kind.name, kind.digest) == (msgtype.replace("/msg", ""), md5sum)
        assert md5sum_of(msgtype, Definition(kind.name, "ros1msg", kind.text.encode(), {})) == md5sum
    assert {msgtype: ros_type(msgtype, "cdr").digest for msgtype in HASHES} == HASHES


def test_md5sums_follow_from_the_definitions_of_bags():
    with open_reader(OFFICE_BAG) as reader:
        for channel in reader.channels.values():
            definition = reader.definition(channel)
            assert md5sum_of(channel.msgtype, definition) == definition.metadata["md5sum"]


def test_no_md5sum_follows_from_an_incomplete_definition():
    with open_reader(OFFICE_MCAP.with_name("incomplete.mcap")) as reader:
        (door,) = (channel for channel in reader.channels.values() if channel.topic == "/door")
        with pytest.raises(BagError, match="office_msgs"):
            md5sum_of(door.msgtype, reader.definition(door))


def test_a_retyped_topic_keeps_its_publisher_and_takes_the_bags_own_definition():
    with open_reader(OFFICE_MCAP) as reader:
        topics = {channel.topic: channel for channel in reader.channels.values()}
        like = reader.definition(topics["/tf_static"])
        made = retyped(reader, "nav_msgs/msg/Odometry", topics["/tf_static"])
        odom = reader.definition(topics["/odom"])
        assert made[:3] == odom[:3]
        assert made.metadata["offered_qos_profiles"] == like.metadata["offered_qos_profiles"]
        assert made.metadata["topic_type_hash"] == odom.metadata["topic_type_hash"]
        with pytest.raises(BagError, match="office_msgs/msg/Window"):
            retyped(reader, "office_msgs/msg/Window", topics["/tf_static"])


def test_a_type_that_is_unknown_stays_without_text():
    nothing = Definition("office_msgs/msg/Window", "", b"", {})
    assert with_common_text(nothing, "office_msgs/msg/Window", "cdr") == nothing
    assert b"geometry_msgs/TransformStamped" in with_common_text(nothing, "tf2_msgs/msg/TFMessage", "cdr").text
