"""Chunks that are joined for numpy's sake are written as chunks, to the bytes that they would have had alone."""

import numpy as np
import pytest
from oracles import OFFICE_BAG, OFFICE_MCAP, copy, mcap_messages, ros1_messages

from odomcorrupt.bags.block import Message, joined
from odomcorrupt.bags.open import open_reader, open_writer

BAGS = {
    "mcap": (OFFICE_MCAP, ".mcap", {}),
    "mcap none": (OFFICE_MCAP, ".mcap", {"compression": "none"}),
    "ros1": (OFFICE_BAG, ".bag", {}),
    "ros1 to mcap": (OFFICE_BAG, ".mcap", {"compression": "lz4"}),
}


def copy_joined(source, target, change=None, **options):
    with open_reader(source) as reader, open_writer(target, reader, **options) as writer:
        for block in joined(reader.blocks()):
            if change:
                change(writer, block)
            writer.write(block)
    return target


@pytest.mark.parametrize(("source", "suffix", "options"), BAGS.values(), ids=BAGS)
def test_joined_or_not_the_bytes_are_the_same(source, suffix, options, tmp_path):
    alone = copy(source, tmp_path / f"alone{suffix}", **options)
    together = copy_joined(source, tmp_path / f"together{suffix}", **options)
    assert alone.read_bytes() == together.read_bytes()


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG], ids=["mcap", "ros1"])
def test_joined_blocks_are_fewer_and_hold_the_same(source):
    def messages(blocks):
        return [
            (channel, log_ns, block.data[offset : offset + length].tobytes())
            for block in blocks
            for channel, log_ns, offset, length in block.table.tolist()
        ]

    with open_reader(source) as reader:
        alone, together = list(reader.blocks()), list(joined(reader.blocks()))
    assert 2 * len(together) < len(alone)
    assert messages(together) == messages(alone)
    for block in together:
        assert block.data.flags.writeable
        assert all(0 < end <= block.data.size for end in block.ends)
        assert np.all(np.diff(block.ends) > 0)


@pytest.mark.parametrize(("source", "suffix"), [(OFFICE_MCAP, ".mcap"), (OFFICE_BAG, ".bag")])
def test_what_is_added_to_a_joined_block_is_read_by_others(source, suffix, tmp_path):
    seen = mcap_messages if suffix == ".mcap" else ros1_messages
    made = {}

    def add(writer, block):
        if not len(block.table):
            return
        if not made:
            odom = next(one for one in channels if one.topic == "/odom")
            made["channel"] = writer.add_channel("/more", odom.msgtype, odom)
        block.added.append(Message(made["channel"].id, int(block.table["log_ns"][0]), b"added"))

    with open_reader(source) as reader:
        channels = list(reader.channels.values())
        count = sum(len(block.table) > 0 for block in joined(reader.blocks()))
    out = copy_joined(source, tmp_path / f"out{suffix}", add)
    added = [one for one in seen(out) if one.topic == "/more"]
    assert [one.data for one in added] == [b"added"] * count
    assert [one for one in seen(out) if one.topic != "/more"] == seen(source)


def test_chunks_of_two_compressions_are_not_joined(tmp_path):
    with open_reader(OFFICE_MCAP) as reader:
        (one, other) = list(reader.blocks())[1:3]
        assert len(list(joined([one, other]))) == 1
        other.raw = type(other.raw)("chunk", "lz4" if one.raw.codec != "lz4" else "none")
        assert len(list(joined([one, other]))) == 2
