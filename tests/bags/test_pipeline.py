"""From the source of a bag to the pipeline."""

import io
import threading

import pytest

from odomcorrupt.bags import pipeline
from odomcorrupt.bags.pipeline import OrderedResults, Workers
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError


class Dribble(io.RawIOBase):
    """A pipe that gives a few bytes at a time."""

    def __init__(self, data):
        self.left = memoryview(data)

    def readable(self):
        return True

    def readinto(self, view):
        size = min(len(view), len(self.left), 7)
        view[:size] = self.left[:size]
        self.left = self.left[size:]
        return size


DATA = bytes(range(256)) * 8


def sources(tmp_path):
    (tmp_path / "data").write_bytes(DATA)
    return [
        Source.of_file(tmp_path / "data"),
        Source(io.BytesIO(DATA), "pipe"),
        Source(Dribble(DATA), "raw"),
        Source(io.BufferedReader(Dribble(DATA)), "slow"),
    ]


def test_every_way_of_reading_gives_the_same_bytes(tmp_path):
    for source in sources(tmp_path):
        assert source.sniff(16) == DATA[:16]
        assert source.sniff(4) == DATA[:4]
        assert source.read(3, "begin") == DATA[:3]
        assert source.read_array(40, "array").tobytes() == DATA[3:43]
        assert bytes(source.read_scratch(50, "scratch")) == DATA[43:93]
        assert source.position == 93
        assert not source.at_end()
        assert source.read(len(DATA) - 93, "rest") == DATA[93:]
        assert source.at_end()
        assert source.read(0, "nothing") == b""
        source.close()


@pytest.mark.parametrize("claim", [len(DATA) + 1, 2**31, 2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("way", ["read", "read_array", "read_scratch"])
def test_a_claim_beyond_the_end_is_an_error_that_names_it(tmp_path, claim, way):
    for source in sources(tmp_path):
        source.read(4, "begin")
        with pytest.raises(BagError, match=r"the thing at byte .*recover=True"):
            getattr(source, way)(claim, "the thing")
        source.close()


def test_a_pipe_stays_open_when_the_source_closes():
    stream = io.BytesIO(DATA)
    with Source(stream, "pipe") as source:
        source.read(1, "one")
    assert not stream.closed


def test_what_is_put_behind_does_not_wait_for_ever(monkeypatch):
    monkeypatch.setattr(pipeline, "WAITING_BYTES", 10)
    go, taken = threading.Event(), []
    with Workers(2) as workers:
        results = OrderedResults(workers)
        results.put(go.wait, taken.append, 1)
        threading.Timer(0.05, go.set).start()
        for number in range(100):
            results.put(lambda number=number: number, taken.append, 1, worth=False)
            assert number + 2 - len(taken) <= 10
        results.finish()
    assert taken == [True, *range(100)]
