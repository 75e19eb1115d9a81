"""ROS 1 bags in and out, judged by the rosbags library."""

import struct

import numpy as np
import pytest
from oracles import (
    OFFICE_BAG,
    adding,
    copy,
    copy_through_pipes,
    damaged_copies_fail,
    mcap_messages,
    require_shifted,
    rewritten,
    ros1_messages,
    shift,
)
from rosbags.rosbag1 import Reader, Writer

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.errors import BagError
from recordings import RECORDINGS

CODECS = ["none", "lz4", "bz2"]
INDEXED = [path for path in sorted(RECORDINGS.rglob("*.bag")) if "malformed" not in path.parts]
MESSAGE, BAG_HEADER, INDEX, CHUNK = 2, 3, 4, 5


def record_at(data, at):
    """Return (header fields, header, data) of a record of a ROS 1 bag."""
    (length,) = struct.unpack_from("<I", data, at)
    header = data[at + 4 : at + 4 + length]
    (size,) = struct.unpack_from("<I", data, at + 4 + length)
    begin = at + 8 + length
    return fields_of(header), header, data[begin : begin + size]


def records(data, at=13):
    found = []
    while at < len(data):
        found.append(record_at(data, at))
        at += 8 + len(found[-1][1]) + len(found[-1][2])
    return found


def fields_of(header):
    fields, at = {}, 0
    while at < len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, value = header[at + 4 : at + 4 + length].split(b"=", 1)
        fields[name.decode()] = value
        at += 4 + length
    return fields


def packed(header, data):
    if isinstance(header, dict):
        header = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
            for name, value in header.items()
        )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def rebuilt(path, changed):
    """Write records as a bag again, with the index where it is now."""
    at = 13 + sum(len(packed(header, data)) for fields, header, data in changed if fields["op"][0] in (3, 4, 5))
    fields = dict(changed[0][0], index_pos=struct.pack("<Q", at))
    body = b"".join(packed(header, data) for _, header, data in changed[1:])
    path.write_bytes(b"#ROSBAG V2.0\n" + packed(fields, changed[0][2]) + body)
    return path


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    """The first twelve seconds of the office, by the rosbags library, in a dozen chunks."""
    path = tmp_path_factory.mktemp("office") / "office.bag"
    writer = Writer(path)
    writer.chunk_threshold = 30_000
    rewritten(Reader(OFFICE_BAG), writer, seconds=12)
    return path


@pytest.fixture(params=CODECS)
def bag(request, office, tmp_path):
    return copy(office, tmp_path / "in.bag", compression=request.param)


def test_nothing_patched_keeps_every_message_and_connection(office, bag, tmp_path):
    assert ros1_messages(bag) == ros1_messages(office)
    out = copy(bag, tmp_path / "out.bag")
    assert ros1_messages(out) == ros1_messages(office)
    assert out.read_bytes() == bag.read_bytes()


def test_connections_stay_bit_identical_in_index_and_chunks(office, tmp_path):
    out = copy(office, tmp_path / "out.bag")

    def connections(path):
        return [(header, data) for fields, header, data in records(path.read_bytes()) if fields["op"] == b"\x07"]

    assert connections(out) == connections(office)


def test_lz4_frames_are_what_real_ros_1_reads(office, tmp_path):
    out = copy(office, tmp_path / "out.bag", compression="lz4")
    for fields, _, data in records(out.read_bytes()):
        if fields["op"][0] == CHUNK:
            # Version 1, independent blocks, no block checksums, no content size, a content checksum, no dictionary.
            assert data[:5] == b"\x04\x22\x4d\x18\x64"


def test_patched_numbers_are_what_another_decoder_reads(bag, tmp_path):
    require_shifted(ros1_messages(bag), ros1_messages(copy(bag, tmp_path / "out.bag", shift)), 1)


def test_a_bag_becomes_a_ros1_mcap_and_a_bag_again(bag, tmp_path):
    through_file = copy(bag, tmp_path / "out.mcap")
    through_pipe = copy_through_pipes(bag, tmp_path / "pipe.mcap")
    assert through_pipe.read_bytes() == through_file.read_bytes()
    seen = sorted(mcap_messages(through_file, seek=True), key=lambda one: (one.times[0], one.topic))
    expected = sorted(ros1_messages(bag), key=lambda one: (one.times[0], one.topic))
    assert [(one.topic, one.times[0], one.data) for one in seen] == [(x.topic, x.times[0], x.data) for x in expected]
    for one, other in zip(seen, expected, strict=True):
        assert one.type == (other.type[0].replace("/msg/", "/"), "ros1msg", other.type[2].encode())
        metadata = dict(one.publisher[1:])
        assert (metadata["md5sum"], metadata["callerid"]) == (other.type[1], other.publisher[0])
        assert int(metadata["latching"]) == other.publisher[1]
    back = copy(through_file, tmp_path / "back.bag")
    assert ros1_messages(back) == ros1_messages(bag)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_added_messages_and_channels_are_there_latched_as_the_other(bag, tmp_path, suffix):
    out = copy(bag, tmp_path / f"out{suffix}", adding("/tf_static", "/tf_copy", b"added"))
    if suffix == ".mcap":
        out = copy(out, tmp_path / "back.bag")
    seen = ros1_messages(out)
    added = [one for one in seen if one.data == b"added"]
    static = next(one for one in seen if one.topic == "/tf_static")
    assert {one.topic for one in added} == {"/tf_copy", "/pose", "/tf_static"}
    twin = next(one for one in added if one.topic == "/tf_copy")
    assert (twin.type, twin.publisher) == (static.type, static.publisher)
    pose = next(one for one in added if one.topic == "/pose")
    assert pose.type[:2] == ("geometry_msgs/msg/PoseStamped", "d3812c3cbc69362b77dc0b19b345f8f5")
    assert pose.publisher == static.publisher
    assert [one for one in seen if one.data != b"added"] == ros1_messages(bag)


@pytest.mark.parametrize("order", [("op", "conn", "time"), ("time", "conn", "op", "more"), "mixed"])
@pytest.mark.parametrize("harm", ["none", "missing", "unordered", "wrong", "short"])
def test_field_order_and_wrong_indexes_do_not_matter(office, tmp_path, order, harm):
    changed = []
    data = copy(office, tmp_path / "plain.bag", compression="none").read_bytes()
    places = []
    for number, (fields, header, content) in enumerate(records(data)):
        if fields["op"][0] == CHUNK:
            chunk, places = _reordered(content, order)
            changed.append((fields, dict(fields, size=struct.pack("<I", len(chunk))), chunk))
        elif fields["op"][0] != INDEX:
            changed.append((fields, header, content))
        elif harm != "missing" or number % 2:
            changed.append((fields, header, _harmed(content, places, harm if number % 3 else "unordered")))
    source = rebuilt(tmp_path / "in.bag", changed)
    out = copy(source, tmp_path / "out.bag")
    assert ros1_messages(out) == ros1_messages(office)


def _harmed(index, places, harm):
    """Write an index with the places records went to, and some wrong ones."""
    entries = np.frombuffer(index, "<u4").reshape(-1, 3).copy()
    entries[:, 2] = [places[offset] for offset in entries[:, 2].tolist()]
    if harm == "wrong":
        entries[0, 2] = 3 if len(entries) % 2 else 2**32 - 1
    return (entries[::-1] if harm == "unordered" else entries[harm == "short" :]).tobytes()


def _reordered(chunk, order):
    """Write a chunk's message headers with their fields in another order; return it and where records went."""
    out, places, at = b"", {}, 0
    while at < len(chunk):
        begin, (fields, header, data) = at, record_at(chunk, at)
        at += 8 + len(header) + len(data)
        places[begin] = len(out)
        if fields["op"][0] == MESSAGE:
            names = order if order != "mixed" else [("op", "conn", "time"), ("time", "op", "conn")][begin % 2]
            fields["more"] = b"something"
            header = {name: fields[name] for name in names}
        out += packed(header, data)
    return out, places


def test_a_bag_cut_anywhere_is_an_error_and_leaves_nothing(bag, tmp_path):
    source = tmp_path.parent / f"{tmp_path.name}.bag"
    bag.rename(source)
    size = source.stat().st_size
    offsets = [*range(0, 4200, 470), *np.linspace(4200, size - 1, 12).astype(int).tolist(), *range(size - 40, size, 5)]
    assert damaged_copies_fail(source, tmp_path, offsets, ".bag") == []


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("claim", [0, 1, 2**31, 2**32 - 1])
def test_a_chunk_that_lies_about_its_size_is_an_error(office, tmp_path, codec, claim):
    source = copy(office, tmp_path / "in.bag", compression=codec)
    changed = records(source.read_bytes())
    place = next(n for n, (fields, _, _) in enumerate(changed) if fields["op"][0] == CHUNK)
    fields, _, content = changed[place]
    changed[place] = (fields, dict(fields, size=struct.pack("<I", claim)), content)
    rebuilt(source, changed)
    with pytest.raises(BagError, match=str(claim)), open_reader(source) as reader:
        list(reader.blocks())


def test_an_unindexed_bag_is_named_so_with_the_way_out(office, tmp_path):
    changed = records(office.read_bytes())
    fields = dict(changed[0][0], index_pos=bytes(8))
    source = tmp_path / "in.bag"
    source.write_bytes(b"#ROSBAG V2.0\n" + packed(fields, changed[0][2]))
    with pytest.raises(BagError, match=r"not indexed.*recover=True"):
        open_reader(source)


def test_an_encrypted_bag_is_refused(office, tmp_path):
    changed = records(office.read_bytes())
    changed[0] = (dict(changed[0][0], encryptor=b"rosbag/AesCbcEncryptor"), *changed[0][1:])
    with pytest.raises(BagError, match="encrypted"):
        open_reader(rebuilt(tmp_path / "in.bag", changed))


def test_cdr_messages_do_not_become_a_ros1_bag(tmp_path):
    with open_reader(OFFICE_BAG.with_suffix(".mcap")) as reader, pytest.raises(BagError, match="cdr"):
        open_writer(tmp_path / "out.bag", reader)
    assert not any(tmp_path.iterdir())


@pytest.mark.recordings
@pytest.mark.parametrize("path", INDEXED, ids=lambda path: path.name)
def test_recordings_of_others_go_through(path, tmp_path):
    assert ros1_messages(copy(path, tmp_path / "out.bag")) == ros1_messages(path)
