"""What is whole of a damaged bag is saved, also behind a length that reaches into it, and what is not is said."""

import io
import shutil
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from oracles import OFFICE_BAG, OFFICE_DB, OFFICE_MCAP, by_chunk, copy, mcap_messages, mcap_record_places, ros1_messages
from test_ros1 import packed, records

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.source import ROS1 as MAGIC
from odomcorrupt.errors import BagError
from recordings import RECORDINGS

SEEN = {".mcap": mcap_messages, ".bag": ros1_messages}


def recover(source, target, stdin=None):
    """Save what can be saved; return what is said to be lost."""
    with open_reader(source, stdin, recover=True) as reader, open_writer(target, reader) as writer:
        for block in reader.blocks():
            writer.write(block)
        assert not any("--recover" in loss for loss in reader.losses)
        return list(reader.losses)


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_a_whole_bag_loses_nothing(source, tmp_path):
    assert recover(source, tmp_path / f"out{source.suffix}") == []
    plain = copy(source, tmp_path / f"plain{source.suffix}")
    assert (tmp_path / f"out{source.suffix}").read_bytes() == plain.read_bytes()


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
@pytest.mark.parametrize("through_pipe", [False, True])
def test_a_cut_bag_keeps_its_whole_chunks_and_says_that_it_was_cut(source, through_pipe, tmp_path):
    data = source.read_bytes()
    everything = set(SEEN[source.suffix](source))
    last = 0
    for share in (0.3, 0.6, 0.9):
        cut = tmp_path / f"cut{source.suffix}"
        cut.write_bytes(data[: int(share * len(data))])
        with pytest.raises(BagError):
            copy(cut, tmp_path / f"no{source.suffix}")
        out = tmp_path / f"out{share}{source.suffix}"
        stdin = io.BytesIO(cut.read_bytes()) if through_pipe else None
        losses = recover(None if through_pipe else cut, out, stdin)
        assert len(losses) >= 1
        assert "truncated" in losses[0]
        saved = SEEN[source.suffix](out)
        assert everything.issuperset(saved)
        assert len(saved) > max(last, 0.8 * share * len(everything))
        last = len(saved)


def test_a_damaged_chunk_of_an_mcap_is_left_out_and_the_others_stay(tmp_path):
    data = bytearray(OFFICE_MCAP.read_bytes())
    chunks = [place for place in mcap_record_places(data) if place[0] == 6]
    middle = (chunks[3][1] + chunks[3][2]) // 2
    data[middle] ^= 0xFF
    (tmp_path / "in.mcap").write_bytes(data)
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert len(losses) == 1
    assert f"byte {chunks[3][1]}" in losses[0]
    saved, everything = mcap_messages(tmp_path / "out.mcap"), mcap_messages(OFFICE_MCAP)
    assert set(saved) < set(everything)
    assert len(saved) > len(everything) * (1 - 2 / len(chunks))


def test_a_damaged_chunk_of_a_ros1_bag_is_left_out_and_the_others_stay(tmp_path):
    changed = records(OFFICE_BAG.read_bytes())
    place = [n for n, (fields, _, _) in enumerate(changed) if fields["op"][0] == 5][3]
    content = bytearray(changed[place][2])
    content[len(content) // 2] ^= 0xFF
    changed[place] = (*changed[place][:2], bytes(content))
    (tmp_path / "in.bag").write_bytes(b"#ROSBAG V2.0\n" + b"".join(packed(head, data) for _, head, data in changed))
    assert len(recover(tmp_path / "in.bag", tmp_path / "out.bag")) == 1
    saved, everything = ros1_messages(tmp_path / "out.bag"), ros1_messages(OFFICE_BAG)
    assert set(saved) < set(everything)
    assert len(saved) > 0.9 * len(everything)


@pytest.mark.slow
@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_any_damage_leaves_a_readable_bag_of_true_messages(source, tmp_path):
    rng = np.random.default_rng(11)
    data = source.read_bytes()
    everything = set(SEEN[source.suffix](source))
    for offset in rng.integers(5000, len(data), 15).tolist():
        damaged = bytearray(data)
        damaged[offset : offset + 20] = rng.integers(0, 256, 20, dtype=np.uint8).tobytes()
        broken = tmp_path / f"in{source.suffix}"
        broken.write_bytes(damaged[: len(data)])
        out = tmp_path / f"out{source.suffix}"
        out.unlink(missing_ok=True)
        losses = recover(broken, out)
        saved = SEEN[source.suffix](out)
        assert everything.issuperset(saved)
        assert losses or len(saved) == len(everything)


@pytest.mark.recordings
def test_the_unindexed_recording_is_read(tmp_path):
    source = RECORDINGS / "bags" / "malformed" / "unindexed.bag"
    losses = recover(source, tmp_path / "out.bag")
    assert len(ros1_messages(tmp_path / "out.bag")) == 608
    assert losses == []


def rows_of(path):
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return set(connection.execute("SELECT id, topic_id, timestamp, data FROM messages"))


@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize(("harm", "least"), [("cut", 0.55), ("pages", 0.9), ("nothing", 1.0)])
def test_a_damaged_sqlite3_keeps_the_rows_of_its_whole_pages(directory, harm, least, tmp_path):
    data = bytearray(OFFICE_DB.read_bytes())
    if harm == "cut":
        del data[int(0.6 * len(data)) :]
    elif harm == "pages":
        for share in (0.3, 0.5, 0.7):
            at = int(share * len(data)) // 4096 * 4096
            data[at : at + 4096] = b"\xff" * 4096
    source = tmp_path / ("in" if directory else "in.db3")
    if directory:
        shutil.copytree(OFFICE_DB.parent, source)
        (source / OFFICE_DB.name).write_bytes(data)
    else:
        source.write_bytes(data)
    if harm != "nothing":
        with pytest.raises(BagError, match="recover=True saves the intact part"):
            copy(source, tmp_path / f"no{source.suffix}")
    out = tmp_path / f"out{source.suffix}"
    losses = recover(source, out)
    everything, saved = rows_of(OFFICE_DB), rows_of(out / OFFICE_DB.name if directory else out)
    assert saved <= everything
    assert len(saved) >= least * len(everything)
    assert bool(losses) == (harm != "nothing")
    if directory and harm != "nothing":
        assert f"message_count: {len(saved)}\n" in (out / "metadata.yaml").read_text()


def test_a_record_that_lies_about_its_length_costs_itself_alone(tmp_path):
    data = bytearray(OFFICE_MCAP.read_bytes())
    chunks = [place for place in mcap_record_places(data) if place[0] == 6]
    for number, claim in ((2, 2**40), (5, 100)):
        data[chunks[number][1] + 1 : chunks[number][1] + 9] = claim.to_bytes(8, "little")
    (tmp_path / "in.mcap").write_bytes(data)
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert any(f"byte {chunks[2][1]}" in loss for loss in losses)
    counts = [len(block.table) for block in by_chunk(OFFICE_MCAP)]
    saved, everything = mcap_messages(tmp_path / "out.mcap"), mcap_messages(OFFICE_MCAP)
    assert set(saved) < set(everything)
    assert len(saved) == len(everything) - counts[2] - counts[5]


@pytest.mark.parametrize("codec", ["none", "lz4", "bz2"])
def test_the_last_chunk_of_a_cut_ros1_bag_keeps_its_whole_messages(codec, tmp_path):
    whole = copy(OFFICE_BAG, tmp_path / "whole.bag", compression=codec)
    data = whole.read_bytes()
    at = data.index(b"compression=", len(data) // 2)
    (tmp_path / "in.bag").write_bytes(data[: at + 60_000])
    losses = recover(tmp_path / "in.bag", tmp_path / "out.bag")
    (tmp_path / "before.bag").write_bytes(data[: at - 4])
    recover(tmp_path / "before.bag", tmp_path / "less.bag")
    saved, less = ros1_messages(tmp_path / "out.bag"), ros1_messages(tmp_path / "less.bag")
    assert set(saved) <= set(ros1_messages(OFFICE_BAG))
    assert "truncated in a chunk" in losses[0]
    # bz2 gives nothing before a block of 900 kB is whole
    assert len(saved) > len(less) or codec == "bz2"


SCHEMA, CHUNK, INDEX, ROS1_CHUNK = 3, 6, 7, 5
CHUNK_HEAD = 9 + 40
RECORD = 9 + 22 + 100
"""Bytes of a message's record in the bag of equal messages."""


def write_equal(path, lengths, *, checksums=True):
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
    data = write_equal(tmp_path / "whole.mcap", [100] * 80, checksums=checksums)
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
    data = write_equal(tmp_path / "whole.mcap", [100] * 30 + [5000] + [100] * 20)
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
    data = write_equal(tmp_path / "whole.mcap", [100] * 80)
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
    data = bytearray(write_equal(tmp_path / "whole.mcap", [100] * 80))
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
