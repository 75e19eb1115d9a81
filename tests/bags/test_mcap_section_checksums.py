"""A byte that is changed outside of an MCAP's chunks is noticed, as far as the file has checksums of its sections."""

import io
import struct
import zlib

import pytest
from mcap.writer import CompressionType
from oracles import mcap_messages, mcap_record, mcap_record_places
from test_mcap_optional_parts import ATTACHMENT, CHUNK, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE, write

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

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
