"""Writers refuse channels that nobody defined, and inputs that change their minds."""

import io
import os

import pytest
from oracles import OFFICE_BAG, OFFICE_MCAP

from odomcorrupt.bags.mcap.writer import ChannelTable
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.ros1.writer import Connections
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_a_channel_that_is_neither_in_the_bag_nor_added_is_refused(source):
    with open_reader(source) as reader:
        with pytest.raises(BagError, match="channel 60000: is neither in the bag nor added to it"):
            ChannelTable(reader).written_id(60000)
        if source == OFFICE_BAG:
            with pytest.raises(BagError, match="channel 60000: is neither in the bag nor added to it"):
                Connections(reader).take_records([60000])


class Broken(io.RawIOBase):
    """A stream on a disk that fails."""

    def readable(self):
        return True

    def read(self, _size=-1):
        raise OSError(5, os.strerror(5))

    readinto = read


def test_a_pipe_that_fails_is_reported():
    with pytest.raises(BagError, match="stdin: cannot be copied to a temporary file: Input/output error"):
        Source(Broken(), "stdin").spooled()
    with pytest.raises(BagError, match="stdin: cannot be read: Input/output error"):
        Source(Broken(), "stdin").read_array(10, "magic")


def test_an_output_that_was_not_opened_or_is_a_stream_is_refused_in_words(tmp_path):
    with pytest.raises(BagError, match="is not open"):
        Output(tmp_path / "out.mcap").write(b"data")
    stream = Output(None, io.BytesIO())
    stream.open()
    with pytest.raises(BagError, match="cannot seek; write this format to a file"):
        stream.rewrite(0, b"data")
