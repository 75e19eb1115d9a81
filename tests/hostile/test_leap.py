"""One stamp from the future is a flaw of one message, for `info` as for the corruption."""

from __future__ import annotations

import json

from smallbags import make_small_bags

from odomcorrupt.bags.messages import gather_stamps_ns, locate, scatter_stamps_ns
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.cli import run


def test_a_single_future_stamp_is_no_restart_of_time(tmp_path, capsys):
    source, leaping = make_small_bags(tmp_path)["mcap zstd"].path, tmp_path / "leaping.mcap"
    layouts = []
    with open_reader(source) as reader, open_writer(leaping, reader) as writer:
        (odom,) = (channel for channel in reader.channels.values() if channel.topic == "/odom")
        for block in reader.blocks():
            for layout in locate(block, odom):
                layouts.append(layout)
                if len(layouts) == 2:
                    stamps_ns = gather_stamps_ns(block, layout, layout.items[0])
                    stamps_ns[0] += 100 * 10**9
                    scatter_stamps_ns(block, layout, layout.items[0], stamps_ns)
            writer.write(block)
    said = []
    for path in (source, leaping):
        assert run(["info", str(path), "--json"]) == 0
        (one,) = json.loads(capsys.readouterr().out)["odometry"]
        said.append(one)
    before, after = said
    assert before["restarts"] == after["restarts"] == 0
    assert after["duration_s"] == before["duration_s"]
    assert any("far ahead of their neighbours" in odd for odd in after["oddities"])
    assert not any("far ahead" in odd for odd in before["oddities"])
