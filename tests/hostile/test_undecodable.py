"""A message that is a whole record of damaged bytes: refused in a line, left out and counted with --recover."""

import contextlib
import io
import re
from collections import Counter

import numpy as np
import pytest
from bagged import messages_in

from odomcorrupt.bags.messages import locate
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.cli import run

KINDS = (
    "mcap zstd", "mcap none", "mcap unchunked", "mcap of ros1", "mcap directory", "ros1 none", "ros1 bz2",
    "sqlite3 file", "sqlite3 directory",
)  # fmt: skip
DAMAGED = {"/odom": {3, 4, 11}, "/tf": {0, 9}}
"""Which messages of a topic are damaged, by their order."""


def damaged(source, target, damage=DAMAGED, compression=None):
    """Copy a bag, all of whose checksums are true, with the length of the first string of some messages changed."""
    seen = dict.fromkeys(damage, 0)
    with open_reader(source) as reader, open_writer(target, reader, compression=compression) as writer:
        for block in reader.blocks():
            for channel in reader.channels.values():
                for layout in locate(block, channel) if channel.topic in damage else ():
                    for start in layout.starts:
                        if seen[channel.topic] in damage[channel.topic]:
                            at = start + layout.items[0].stamp + 8  # in what a frame's length is
                            block.data[at : at + 4] = np.frombuffer(b"\xff\xff\xff\x7f", dtype=np.uint8)
                        seen[channel.topic] += 1
            writer.write(block)
    return target


def without_damaged(everything, damage=DAMAGED):
    seen = dict.fromkeys(damage, 0)
    kept = []
    for message in everything:
        topic = message[0]
        if topic in damage:
            seen[topic] += 1
            if seen[topic] - 1 in damage[topic]:
                continue
        kept.append(message)
    return kept


def call(*words):
    """Return the exit code, and what is written to stderr."""
    with contextlib.redirect_stderr(io.StringIO()) as err, contextlib.redirect_stdout(io.StringIO()):
        code = run([str(word) for word in words])
    return code, err.getvalue()


@pytest.mark.parametrize("compression", [None, "message"])
@pytest.mark.parametrize("kind", KINDS)
def test_they_are_left_out_alone_and_counted_by_topic(kind, compression, bags, tmp_path):
    source = bags[kind].path
    if compression and not source.is_dir():
        pytest.skip("only the messages of a directory are compressed one by one")
    bad = damaged(source, tmp_path / ("bad" + source.suffix), compression=compression)
    out = tmp_path / ("out" + source.suffix)
    code, said = call(bad, out, "--seed", "7")
    assert (code, said.count("\n"), said[:13]) == (1, 1, "odomcorrupt: "), said
    assert "--recover leaves such messages out" in said
    assert not out.exists()

    code, said = call(bad, out, "--seed", "7", "--recover", "-v")
    assert code == 3, said
    lost = Counter()
    for count, topic in re.findall(r"(\d+) of the messages of (\S+) cannot be decoded: left out", said):
        lost[topic] += int(count)
    assert lost == {topic: len(places) for topic, places in DAMAGED.items()}
    files = len(list(bad.glob("*.mcap"))) if bad.is_dir() else 1
    assert said.count("Lost: ") <= 2 * max(files, 1)
    saved = messages_in(out)
    expected = without_damaged(messages_in(source))
    assert [one[:2] for one in saved] == [one[:2] for one in expected]
    untouched = [one for one in expected if one[0] not in DAMAGED]
    assert [one for one in saved if one[0] not in DAMAGED] == untouched
    assert call("info", out)[0] == 0


@pytest.mark.parametrize("kind", ["mcap zstd", "ros1 none", "sqlite3 file"])
def test_each_is_read_by_other_formats_too(kind, bags, tmp_path):
    bad = damaged(bags[kind].path, tmp_path / ("bad" + bags[kind].path.suffix))
    out = tmp_path / "out.mcap"
    assert call(bad, out, "--seed", "7", "--recover")[0] == 3
    assert len(messages_in(out)) == bags[kind].count - sum(map(len, DAMAGED.values()))


@pytest.mark.parametrize("kind", ["mcap zstd", "ros1 none", "sqlite3 file"])
def test_what_is_not_corrupted_is_left_out_too_so_that_the_output_can_be_studied(kind, bags, tmp_path):
    source = bags[kind].path
    damage = {"/imu": {1, 2}}
    bad = damaged(source, tmp_path / ("bad" + source.suffix), damage)
    assert call(bad, tmp_path / ("whole" + source.suffix), "--seed", "7")[0] == 0
    out = tmp_path / ("out" + source.suffix)
    code, said = call(bad, out, "--seed", "7", "--recover")
    assert (code, "LOST" in said, "2 of the messages of /imu cannot be" in " ".join(said.split())) == (3, True, True), (
        said
    )
    assert [one for one in messages_in(out) if one[0] == "/imu"] == [
        one for one in without_damaged(messages_in(source), damage) if one[0] == "/imu"
    ]


def test_an_encoding_that_is_not_read_is_not_damage(bags, tmp_path):
    source = bags["mcap zstd"].path
    parameters = tmp_path / "parameters.mcap"
    with open_reader(source) as reader, open_writer(parameters, reader) as writer:
        for block in reader.blocks():
            imu = next((one.id for one in reader.channels.values() if one.topic == "/imu"), -1)
            for start in block.table["offset"][block.table["channel"] == imu]:
                block.data[start + 1] = 3  # a parameter list
            writer.write(block)
    out = tmp_path / "out.mcap"
    assert call(parameters, out, "--seed", "7", "--recover")[0] == 0
    assert len(messages_in(out)) == bags["mcap zstd"].count


def test_info_counts_them(bags, tmp_path):
    bad = damaged(bags["ros1 none"].path, tmp_path / "bad.bag")
    code, said = call("info", bad, "--recover")
    assert (code, said.count("Lost: ")) == (3, 2)
    assert "3 of the messages of /odom" in said
