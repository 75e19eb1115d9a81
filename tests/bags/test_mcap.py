"""MCAP in, MCAP out, judged by the mcap library."""

import io
import struct
import zlib
from itertools import count, product

import numpy as np
import pytest
from mcap.reader import make_reader
from oracles import (
    OFFICE_MCAP,
    VARIANTS,
    adding,
    copy,
    copy_through_pipes,
    damaged_copies_fail,
    mcap_extras,
    mcap_messages,
    mcap_record_places,
    mcap_records,
    mcap_rewritten,
    office_variant,
    require_shifted,
    shift,
)

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.errors import BagError
from recordings import RECORDINGS

CHUNK, MESSAGE_INDEX, FOOTER, DATA_END = 6, 7, 2, 15


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
    indexes = [data[begin + 9 : end] for opcode, begin, end in mcap_record_places(data) if opcode == MESSAGE_INDEX]
    numbers = count()

    def harmed(opcode, content):
        number = next(numbers)
        if opcode != MESSAGE_INDEX:
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
