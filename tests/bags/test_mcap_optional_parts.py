"""Every combination of what the MCAP specification leaves to the writer is read, and nothing in it is lost."""

import itertools
import struct

import pytest
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, IndexType, Writer
from oracles import copy, mcap_messages, mcap_record, mcap_record_places, mcap_records

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

SWITCHES = ("repeat_channels", "repeat_schemas", "use_chunking", "use_statistics", "use_summary_offsets", "enable_crcs")
EVERY = IndexType.ATTACHMENT | IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX = 1, 2, 3, 4, 5, 6, 7
ATTACHMENT, STATISTICS, METADATA, DATA_END = 9, 11, 12, 15
LATER = 0x55
"""An opcode that a later version of the format may use."""


def write(path, *, indexes=EVERY, data_crcs=True, compression=CompressionType.NONE, **switches):
    """Write two channels of one schema and one of none, by the mcap library."""
    with path.open("wb") as stream:
        options = {"index_types": indexes, "enable_data_crcs": data_crcs, "compression": compression, **switches}
        writer = Writer(stream, chunk_size=100, **options)
        writer.start("ros2", "tests")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = [writer.register_channel(f"/{name}", "cdr", schema, {"offered_qos": name}) for name in "ab"]
        channels.append(writer.register_channel("/none", "json", 0))
        for number in range(9):
            writer.add_message(channels[number % 3], 10 + number, b"\0\1\0\0" + bytes([number]) * number, 10, number)
        writer.add_attachment(1, 2, "plan.txt", "text/plain", b"a corridor\n")
        writer.add_metadata("office", {"floor": "3"})
        writer.finish()


def extras(path):
    return [one for one in mcap_records(path) if isinstance(one, Attachment | Metadata)]


def same(path, out):
    copy(path, out)
    assert mcap_messages(out) == mcap_messages(path)
    assert extras(out) == extras(path) != []
    assert len(mcap_messages(out, seek=True)) == 9
    with open_reader(path) as reader:
        assert {channel.topic for channel in reader.channels.values()} == {"/a", "/b", "/none"}


def test_every_combination_of_optional_parts_is_read(tmp_path):
    kinds = [IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE, EVERY]
    for number, chosen in enumerate(itertools.product((False, True), repeat=len(SWITCHES))):
        path, out = tmp_path / f"{number}.mcap", tmp_path / f"{number}_out.mcap"
        indexes = kinds[(number + number // 4 + number // 16) % 4]
        write(path, indexes=indexes, data_crcs=bool(number & 1), **dict(zip(SWITCHES, chosen, strict=True)))
        same(path, out)


def rewritten(data, change):
    """Return a file whose records were changed one by one; without a summary, whose offsets would be wrong."""
    out = [MAGIC]
    for opcode, begin, end in mcap_record_places(data):
        out += [mcap_record(*one) for one in change(opcode, data[begin + 9 : end])]
        if opcode == DATA_END:
            break
    return b"".join([*out, mcap_record(FOOTER, bytes(20)), MAGIC])


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize("chunked", [False, True])
@pytest.mark.parametrize("extended", [HEADER, SCHEMA, CHANNEL, CHUNK, METADATA, DATA_END])
def test_fields_that_a_later_version_appends_are_passed_over(extended, chunked, recover, tmp_path):
    path, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    write(path, use_chunking=chunked, data_crcs=False)
    wanted = mcap_messages(path)

    def later(opcode, content):
        return [(opcode, content + b"later" * (opcode == extended))]

    path.write_bytes(rewritten(path.read_bytes(), later))
    with open_reader(path, recover=recover) as reader:
        assert sum(len(block.table) for block in reader.blocks()) == 9
        assert reader.losses == []
    copy(path, out)
    assert mcap_messages(out) == wanted


@pytest.mark.parametrize("chunked", [False, True])
def test_records_of_a_later_version_are_passed_on(chunked, tmp_path):
    path, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    write(path, use_chunking=chunked, data_crcs=False)
    wanted = mcap_messages(path)
    path.write_bytes(
        rewritten(path.read_bytes(), lambda opcode, content: [(LATER, b"what for?"), (opcode, content)][opcode < 2 :])
    )
    copy(path, out)
    assert mcap_messages(out) == wanted
    assert out.read_bytes().count(b"what for?") == path.read_bytes().count(b"what for?") > 3


def test_a_summary_that_is_empty_or_has_only_statistics_is_one(tmp_path):
    path = tmp_path / "in.mcap"
    write(path, repeat_channels=False, repeat_schemas=False, use_summary_offsets=False, indexes=IndexType.NONE)
    same(path, tmp_path / "out.mcap")
    write(
        path, repeat_channels=False, repeat_schemas=False, use_summary_offsets=False, indexes=IndexType.NONE,
        use_statistics=False,
    )  # fmt: skip
    data = bytearray(path.read_bytes())
    struct.pack_into("<QQI", data, len(data) - 28, len(data) - 37, 0, 0)  # a section that begins where it ends
    path.write_bytes(data)
    same(path, tmp_path / "again.mcap")


@pytest.mark.parametrize(("opcode", "what"), [(CHANNEL, "channel"), (SCHEMA, "schema")])
def test_one_id_for_two_things_is_damage(opcode, what, tmp_path):
    path = tmp_path / "in.mcap"
    write(path, use_chunking=False)

    def twice(kind, content):
        other = content.replace(b"/a", b"/x").replace(b"string", b"strinG")
        return [(kind, content), *([(kind, other)] if kind == opcode and other != content else [])]

    path.write_bytes(rewritten(path.read_bytes(), twice))
    with pytest.raises(BagError, match=f"{what} 1 is defined twice, differently"):
        open_reader(path)
