"""MCAP in, MCAP out, judged by the mcap library, in every combination that the specification leaves to the writer."""

import io
import itertools
import struct
import zlib
from itertools import count, product

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, IndexType, Writer
from oracles import MCAP_MAGIC as MAGIC
from oracles import (
    OFFICE_MCAP,
    VARIANTS,
    adding,
    copy,
    copy_through_pipes,
    damaged_copies_fail,
    mcap_extras,
    mcap_messages,
    mcap_record,
    mcap_record_places,
    mcap_records,
    mcap_rewritten,
    office_variant,
    require_shifted,
    shift,
)
from oracles import mcap_rewritten as rewritten

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.errors import BagError
from recordings import RECORDINGS


@pytest.fixture(scope="module", params=VARIANTS)
def variant(request, tmp_path_factory):
    options = {"chunk_size": 9_000, **VARIANTS[request.param]}
    return office_variant(tmp_path_factory.mktemp("variant") / "in.mcap", 4.0, **options)


def test_nothing_patched_keeps_every_message_channel_and_extra(variant, tmp_path):
    out = copy(variant, tmp_path / "out.mcap")
    assert mcap_messages(out) == mcap_messages(variant)
    assert mcap_extras(out)[0] == mcap_extras(variant)[0]
    # Without indexes the library does not find extras by seeking; the output has indexes again.
    records = mcap_records(variant)
    assert len(mcap_extras(out)[1]) == sum(type(one).__name__ == "Attachment" for one in records)
    assert len(mcap_extras(out)[2]) == sum(type(one).__name__ == "Metadata" for one in records) == 1


def test_records_of_the_data_section_stay_in_place(variant, tmp_path):
    out = copy(variant, tmp_path / "out.mcap")
    rebuilt = {"MessageIndex", "ChunkIndex", "AttachmentIndex", "MetadataIndex", "Statistics"}

    def data(path):
        records = mcap_records(path)
        end = next(n for n, one in enumerate(records) if type(one).__name__ == "DataEnd")
        return [one for one in records[:end] if type(one).__name__ not in rebuilt]

    assert data(out) == data(variant)


def test_a_pipe_gives_the_same_bytes_as_a_file(variant, tmp_path):
    through_file = copy(variant, tmp_path / "file.mcap")
    through_pipe = copy_through_pipes(variant, tmp_path / "pipe.mcap")
    assert through_pipe.read_bytes() == through_file.read_bytes()


def test_the_summary_is_complete_and_every_checksum_true(variant, tmp_path):
    out = copy(variant, tmp_path / "out.mcap")
    data = out.read_bytes()
    places = mcap_record_places(data)
    end = next(begin for opcode, begin, _ in places if opcode == DATA_END)
    assert struct.unpack_from("<I", data, end + 9) == (zlib.crc32(data[:end]),)
    (opcode, footer, stop) = places[-1]
    start, _, crc = struct.unpack_from("<QQI", data, footer + 9)
    assert opcode == FOOTER
    assert crc == zlib.crc32(data[start : stop - 4])
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    messages = mcap_messages(variant)
    assert mcap_messages(out, seek=True) == sorted(messages, key=lambda one: one.times[0])
    statistics = summary.statistics
    assert statistics.message_count == len(messages) == sum(statistics.channel_message_counts.values())
    assert statistics.message_start_time == min(one.times[0] for one in messages)
    assert statistics.message_end_time == max(one.times[0] for one in messages)
    assert statistics.chunk_count == len(summary.chunk_indexes) == sum(place[0] == CHUNK for place in places)
    assert statistics.attachment_count == len(summary.attachment_indexes)
    assert statistics.metadata_count == len(summary.metadata_indexes)
    assert len(summary.channels) == statistics.channel_count == len(summary.schemas) + 1


@pytest.mark.parametrize(("codec", "level"), [("none", None), ("lz4", 5), ("zstd", 3)])
def test_compression_asked_for_is_used(variant, tmp_path, codec, level):
    out = copy(variant, tmp_path / "out.mcap", compression=codec, level=level)
    assert mcap_messages(out) == mcap_messages(variant)
    with out.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    assert {index.compression for index in indexes} == {codec.replace("none", "")}


def test_patched_numbers_are_what_another_decoder_reads(variant, tmp_path):
    require_shifted(mcap_messages(variant), mcap_messages(copy(variant, tmp_path / "out.mcap", shift)))


@pytest.mark.parametrize("through", [copy, copy_through_pipes])
def test_added_messages_and_channels_are_there_with_their_qos(variant, tmp_path, through):
    data = b"\0\1\0\0" + bytes(12)
    seen = mcap_messages(through(variant, tmp_path / "out.mcap", adding("/odom", "/odom_truth", data)))
    added = [one for one in seen if one.data == data]
    odom = next(one for one in seen if one.topic == "/odom")
    assert {one.topic for one in added} == {"/odom_truth", "/pose", "/odom"}
    truth = next(one for one in added if one.topic == "/odom_truth")
    assert (truth.type, truth.publisher) == (odom.type, odom.publisher)
    pose = next(one for one in added if one.topic == "/pose")
    assert pose.type[0] == "geometry_msgs/msg/PoseStamped"
    assert b"MSG: geometry_msgs/Pose" in pose.type[2]
    assert [one for one in seen if one not in added] == mcap_messages(variant)


def test_provenance_is_metadata(tmp_path):
    with open_reader(OFFICE_MCAP) as reader, open_writer(tmp_path / "out.mcap", reader) as writer:
        writer.provenance("odomcorrupt", {"seed": "7"})
        for block in reader.blocks():
            writer.write(block)
    assert ("odomcorrupt", {"seed": "7"}) in mcap_extras(tmp_path / "out.mcap")[2]
    assert ("office", {"floor": "3"}) in mcap_extras(tmp_path / "out.mcap")[2]


@pytest.mark.parametrize("harm", ["missing", "unordered", "shifted", "short", "other chunk's"])
def test_wrong_message_indexes_do_not_matter(tmp_path, harm):
    data = OFFICE_MCAP.read_bytes()
    indexes = [data[begin + 9 : end] for opcode, begin, end in mcap_record_places(data) if opcode == INDEX]
    numbers = count()

    def harmed(opcode, content):
        number = next(numbers)
        if opcode != INDEX:
            return [(opcode, bytes(4) if opcode == DATA_END else content)]
        pairs = [content[at : at + 16] for at in range(6, len(content), 16)]
        if harm == "missing" and number % 3:
            return []
        if harm == "unordered":
            pairs.reverse()
        if harm == "shifted":
            pairs[0] = struct.pack("<QQ", 0, 2**63 if number % 2 else 3)
        if harm == "short":
            pairs[0] = pairs[-1]
        wrong = indexes[number % len(indexes)] if harm == "other chunk's" else content[:6] + b"".join(pairs)
        return [(opcode, wrong)]

    (tmp_path / "in.mcap").write_bytes(mcap_rewritten(data, harmed))
    copy(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert mcap_messages(tmp_path / "out.mcap") == mcap_messages(OFFICE_MCAP)


def test_records_of_applications_come_through_in_place(tmp_path):
    private, chunks = bytes(range(250)) * 36_000, count()

    def before_the_third_chunk(opcode, content):
        third = opcode == CHUNK and next(chunks) == 2
        return [*[(0x91, private)] * third, (opcode, bytes(4) if opcode == DATA_END else content)]

    source = tmp_path / "in.mcap"
    source.write_bytes(mcap_rewritten(OFFICE_MCAP.read_bytes(), before_the_third_chunk))
    copy(source, tmp_path / "out.mcap", compression="none")
    out = (tmp_path / "out.mcap").read_bytes()
    found = mcap_record_places(out)
    position = next(n for n, place in enumerate(found) if place[0] == 0x91)
    assert out[found[position][1] + 9 : found[position][2]] == private
    assert sum(place[0] == CHUNK for place in found[:position]) == 2
    assert mcap_messages(tmp_path / "out.mcap") == mcap_messages(OFFICE_MCAP)


def test_a_bag_cut_anywhere_is_an_error_and_leaves_nothing(variant, tmp_path):
    size = variant.stat().st_size
    offsets = [*range(0, 12, 3), *np.linspace(20, size - 1, 12).astype(int).tolist(), *range(size - 40, size, 5)]
    assert damaged_copies_fail(variant, tmp_path, offsets, ".mcap") == []


@pytest.mark.parametrize("codec", ["zstd", "lz4", "none"])
def test_a_chunk_that_lies_is_an_error_before_memory_is_taken(tmp_path, codec):
    source = copy(OFFICE_MCAP, tmp_path / "in.mcap", compression=codec)
    sound = source.read_bytes()
    begin = [begin for opcode, begin, _ in mcap_record_places(sound) if opcode == CHUNK][1]
    packed = 41 + (len(codec) if codec != "none" else 0)
    numbers = {"record": (1, "<Q"), "size": (25, "<Q"), "crc": (33, "<I"), "name": (37, "<I"), "packed": (packed, "<Q")}
    for (offset, kind), claim in product(numbers.values(), (0, 1, 2**31 - 1, 2**40, 2**63, 2**64 - 1)):
        data = bytearray(sound)
        struct.pack_into(kind, data, begin + offset, claim % 2 ** (8 * struct.calcsize(kind)) or 1)
        source.write_bytes(data)
        for stream in (None, io.BytesIO(data)):
            with pytest.raises(BagError), open_reader(None if stream else source, stream) as reader:
                for _ in reader.blocks():
                    pass


@pytest.mark.recordings
@pytest.mark.parametrize("path", sorted(RECORDINGS.rglob("*.mcap")), ids=lambda path: path.name)
def test_recordings_of_others_go_through(path, tmp_path):
    out = copy(path, tmp_path / "out.mcap")
    assert mcap_messages(out) == mcap_messages(path)
    assert mcap_extras(out) == mcap_extras(path)


@pytest.mark.recordings
def test_recordings_of_others_were_read():
    assert list(RECORDINGS.rglob("*.mcap"))


def test_a_file_can_be_read_twice_and_a_pipe_once():
    with open_reader(OFFICE_MCAP) as reader:
        assert reader.complete
        assert len(list(reader.blocks())) == len(list(reader.blocks()))
    with open_reader(None, io.BytesIO(OFFICE_MCAP.read_bytes())) as reader:
        list(reader.blocks())
        with pytest.raises(BagError, match="once"):
            list(reader.blocks())


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
