"""What the MCAP specification leaves to the writer is read in every combination; checksums of sections are compared."""

import io
import itertools
import struct
import zlib

import pytest
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, IndexType, Writer
from oracles import MCAP_MAGIC as MAGIC
from oracles import copy, mcap_messages, mcap_record, mcap_record_places, mcap_records
from oracles import mcap_rewritten as rewritten

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

SWITCHES = ("repeat_channels", "repeat_schemas", "use_chunking", "use_statistics", "use_summary_offsets", "enable_crcs")
EVERY = IndexType.ATTACHMENT | IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
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


DATA = "the checksum of all its data does not match its bytes"
SUMMARY = "the checksum of its summary does not match its bytes"


def read(data, *, recover=False, path=None):
    """Return the payloads of a bag's messages and its losses; through a pipe, or with a path from a file."""
    if path is not None:
        path.write_bytes(data)
    with open_reader(path, io.BytesIO(data), recover=recover) as reader:
        found = [
            bytes(block.data[row["offset"] : row["offset"] + row["length"]])
            for block in reader.blocks()
            for row in block.table
        ]
        return found, reader.losses


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]


@pytest.fixture(scope="module", params=[CompressionType.NONE, CompressionType.ZSTD], ids=["none", "zstd"])
def bag(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "in.mcap"
    write(path, compression=request.param)
    return path.read_bytes()


@pytest.mark.parametrize("piped", [False, True])
def test_every_byte_of_data_outside_of_chunks_is_covered(bag, piped, tmp_path):
    end = next(begin for opcode, begin, _ in mcap_record_places(bag) if opcode == DATA_END)
    inside = [range(begin + 9, after) for opcode, begin, after in mcap_record_places(bag) if opcode == CHUNK]
    outside = [at for at in range(len(MAGIC), end) if not any(at in span for span in inside)]
    assert len(outside) > 300
    for at in outside[:: 2 if piped else 21]:
        with pytest.raises(BagError) as caught:
            read(flipped(bag, at), path=None if piped else tmp_path / "in.mcap")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("piped", [False, True])
def test_what_only_the_checksum_of_all_tells_is_reported_with_the_way_out(bag, piped, tmp_path):
    path = None if piped else tmp_path / "in.mcap"
    harmed = flipped(bag, bag.index(b"floor"))
    with pytest.raises(BagError, match=f"{DATA}: outside of its chunks the bag is damaged; recover=True saves"):
        read(harmed, path=path)
    found, losses = read(harmed, recover=True, path=path)
    assert found == read(bag)[0] != []
    assert [DATA in loss for loss in losses] == [True]


@pytest.mark.parametrize("piped", [False, True])
def test_the_summary_has_a_checksum_of_its_own(bag, piped, tmp_path):
    path = None if piped else tmp_path / "in.mcap"
    begin = next(after for opcode, _, after in mcap_record_places(bag) if opcode == DATA_END)
    footer = next(begin for opcode, begin, _ in mcap_record_places(bag) if opcode == FOOTER)
    for at in range(begin + 9, footer, 11):
        with pytest.raises(BagError):
            read(flipped(bag, at), path=path)
    harmed = flipped(bag, bag.rindex(b"office"))
    with pytest.raises(BagError, match=f"{SUMMARY}: .*recover=True saves"):
        read(harmed, path=path)
    found, losses = read(harmed, recover=True, path=path)
    assert found == read(bag)[0]
    assert [SUMMARY in loss for loss in losses] == [True]


def test_messages_without_chunks_are_covered(tmp_path):
    path = tmp_path / "in.mcap"
    write(path, use_chunking=False)
    data = path.read_bytes()
    assert len(read(data)[0]) == 9
    _, _, end = [place for place in mcap_record_places(data) if place[0] == MESSAGE][-1]
    with pytest.raises(BagError, match=DATA):
        read(flipped(data, end - 1))


COVERAGES = {
    "the file": lambda header, data: MAGIC + header + data,
    "header and data": lambda header, data: header + data,
    "data": lambda _, data: data,
}


@pytest.mark.parametrize("name", COVERAGES)
@pytest.mark.parametrize("piped", [False, True])
def test_the_specification_is_read_in_each_of_its_ways(bag, name, piped, tmp_path):
    path = None if piped else tmp_path / "in.mcap"
    parts = list(mcap_record_places(bag))
    assert parts[0][0] == HEADER
    (_, _, begin), end = parts[0], next(begin for opcode, begin, _ in parts if opcode == DATA_END)
    crc = zlib.crc32(COVERAGES[name](bag[len(MAGIC) : begin], bag[begin:end]))
    summed = bag[:end] + mcap_record(DATA_END, struct.pack("<I", crc)) + bag[end + 13 :]
    assert read(summed, path=path) == read(bag)
    with pytest.raises(BagError, match=DATA):
        read(bag[:end] + mcap_record(DATA_END, struct.pack("<I", crc ^ 1)) + bag[end + 13 :], path=path)


def test_files_without_checksums_are_read(tmp_path):
    path = tmp_path / "in.mcap"
    write(path, data_crcs=False, enable_crcs=False)
    data = path.read_bytes()
    harmed = flipped(data, data.index(b"floor"))
    assert read(harmed) == read(harmed, path=path) == read(data)
    assert len(mcap_messages(path)) == len(read(data)[0])


@pytest.mark.parametrize("piped", [False, True])
@pytest.mark.parametrize("piece", [1 << 22, 30, 7])
def test_an_attachment_has_a_checksum_of_its_own(piped, piece, tmp_path, monkeypatch):
    monkeypatch.setattr("odomcorrupt.bags.mcap.chunk._PIECE_BYTES", piece)
    path = tmp_path / "in.mcap"
    write(path, data_crcs=False)
    data, path = path.read_bytes(), None if piped else path
    begin, end = next((begin, end) for opcode, begin, end in mcap_record_places(data) if opcode == ATTACHMENT)
    whole = read(data, path=path)
    assert read(data[: end - 4] + bytes(4) + data[end:], path=path) == whole
    for at in range(begin + 9, end):
        with pytest.raises(BagError):
            read(flipped(data, at), path=path)
    harmed = flipped(data, data.index(b"a corridor"))
    found, losses = read(harmed, recover=True, path=path)
    assert found == whole[0] != []
    assert len(losses) == 1
    assert "the attachment's checksum does not match its bytes" in losses[0]


def test_an_end_of_data_without_room_for_its_checksum_is_damage(bag):
    end = next(begin for opcode, begin, _ in mcap_record_places(bag) if opcode == DATA_END)
    with pytest.raises(BagError, match="shorter than its checksum"):
        read(bag[:end] + mcap_record(DATA_END, b"\0\0") + mcap_record(FOOTER, bytes(20)) + MAGIC)
