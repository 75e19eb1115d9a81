"""Bytes that are missing from a chunk let its length reach into the next one, whose messages are not lost for that."""

import struct

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from oracles import OFFICE_BAG, by_chunk, copy, mcap_messages, mcap_record_places, ros1_messages
from test_recover import recover
from test_ros1 import records

from odomcorrupt.bags.source import ROS1 as MAGIC

SCHEMA, CHUNK, INDEX, ROS1_CHUNK = 3, 6, 7, 5
CHUNK_HEAD = 9 + 40
RECORD = 9 + 22 + 100
"""Bytes of a message's record in the bag of equal messages."""


def write(path, lengths, *, checksums=True):
    """Write an MCAP of chunks that are not compressed, about ten messages of a hundred bytes each; return its bytes."""
    with path.open("wb") as stream:
        writer = McapLibraryWriter(
            stream, chunk_size=10 * RECORD - 50, compression=CompressionType.NONE, enable_crcs=checksums
        )
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/text", "cdr", schema)
        for number, length in enumerate(lengths):
            writer.add_message(channel, number, bytes([number]) * length, number)
        writer.finish()
    return path.read_bytes()


def counts_of(path):
    """Return how many messages each chunk holds."""
    return [len(block.table) for block in by_chunk(path)]


def judge(whole, saved, first, count):
    """Hold what was saved against the whole bag: of messages, only those of one chunk are missing."""
    there = set(saved)
    missing = [place for place, message in enumerate(whole) if message not in there]
    assert set(missing) <= set(range(first, first + count))
    assert len(missing) > 0


@pytest.mark.parametrize("checksums", [True, False])
@pytest.mark.parametrize("behind", [0, 40, RECORD])
def test_a_length_that_ends_between_two_messages_of_the_next_chunk_of_an_mcap(behind, checksums, tmp_path):
    data = write(tmp_path / "whole.mcap", [100] * 80, checksums=checksums)
    chunks = [place for place in mcap_record_places(data) if place[0] == CHUNK]
    (_, begin, end), (_, next_begin, _) = chunks[3:5]
    missing = (next_begin + CHUNK_HEAD + 2 * RECORD) - end
    at = begin + CHUNK_HEAD + 2 * RECORD + behind
    (tmp_path / "in.mcap").write_bytes(data[:at] + data[at + missing :])
    assert recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    counts = counts_of(tmp_path / "whole.mcap")
    judge(mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap"), sum(counts[:3]), counts[3])


@pytest.mark.parametrize("behind", [CHUNK, INDEX, SCHEMA])
def test_a_length_that_ends_between_two_records_with_the_next_chunk_in_it(behind, tmp_path):
    data = write(tmp_path / "whole.mcap", [100] * 30 + [5000] + [100] * 20)
    places = mcap_record_places(data)
    chunks = [place for place in places if place[0] == CHUNK]
    large = next(number for number, (_, begin, end) in enumerate(chunks) if end - begin > 5000)
    begin, end = chunks[large][1:]
    claimed = next(place[1] for place in places if place[0] == behind and place[1] > chunks[large + 1][1])
    at = begin + CHUNK_HEAD + 10
    (tmp_path / "in.mcap").write_bytes(data[:at] + data[at + claimed - end :])
    assert len(recover(tmp_path / "in.mcap", tmp_path / "out.mcap")) == 1
    counts = counts_of(tmp_path / "whole.mcap")
    whole, saved = mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap")
    judge(whole, saved, sum(counts[:large]), counts[large])


def test_a_chunk_that_claims_more_than_the_rest_of_the_file_and_others_stand_in_it(tmp_path):
    data = write(tmp_path / "whole.mcap", [100] * 80)
    chunks = [place for place in mcap_record_places(data) if place[0] == CHUNK]
    begin, end = chunks[3][1:]
    claimed = len(data)
    lying = bytes([CHUNK]) + struct.pack("<Q", claimed) + data[begin + 9 : begin + 41] + struct.pack("<Q", claimed - 40)
    (tmp_path / "in.mcap").write_bytes(data[:begin] + lying + data[begin + CHUNK_HEAD :])
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert f"needs {claimed} bytes" in losses[0]
    judge(mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap"), 29, 10)
    assert end < len(data)


@pytest.mark.parametrize("index", [2**40, 300, 7])
def test_an_index_that_lies_about_its_length_costs_no_message(index, tmp_path):
    data = bytearray(write(tmp_path / "whole.mcap", [100] * 80))
    begin = [place for place in mcap_record_places(data) if place[0] == INDEX][3][1]
    data[begin + 1 : begin + 9] = struct.pack("<Q", index)
    (tmp_path / "in.mcap").write_bytes(data)
    assert recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert mcap_messages(tmp_path / "out.mcap") == mcap_messages(tmp_path / "whole.mcap")


@pytest.mark.slow
def test_a_length_that_ends_between_two_messages_of_the_next_chunk_of_a_ros1_bag(tmp_path):
    whole = copy(OFFICE_BAG, tmp_path / "whole.bag", compression="none")
    data = whole.read_bytes()
    places, at = [], len(MAGIC)
    for fields, header, content in records(data):
        size = 8 + len(header) + len(content)
        if fields["op"][0] == ROS1_CHUNK:
            places.append((at, at + 8 + len(header), at + size))
        at += size
    counts = counts_of(whole)
    starts = [block.raw.starts for block in by_chunk(whole)]
    (_, content, end), (_, next_content, _) = places[3:5]
    missing = next_content + int(starts[4][5]) - end
    at = content + int(starts[3][2])
    (tmp_path / "in.bag").write_bytes(data[:at] + data[at + missing :])
    losses = recover(tmp_path / "in.bag", tmp_path / "out.bag")
    assert losses
    judge(ros1_messages(whole), ros1_messages(tmp_path / "out.bag"), sum(counts[:3]), counts[3])
