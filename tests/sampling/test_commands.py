"""`sample` and `density`."""

import csv
import json
import re

import numpy as np
import pytest

from odomcorrupt.cli import run


def test_article_banana_needs_no_more_words(tmp_path, capsys):
    picture = tmp_path / "banana.png"
    assert run(["sample", "-o", str(picture)]) == 0
    said = capsys.readouterr().out
    assert "1000 of seed" in said
    assert "rot_trans 0.2618" in said
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_same_seed_gives_the_same_picture_to_the_bit(tmp_path):
    for name in ("a.svg", "b.svg"):
        assert run(["sample", "-o", str(tmp_path / name), "--seed", "4", "-n", "50"]) == 0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_csv_and_json_hold_the_same_samples(tmp_path):
    for name in ("s.csv", "s.json"):
        assert run(["sample", "--end", "1,0.2,20deg", "-n", "20", "--seed", "5", "-o", str(tmp_path / name)]) == 0
    content = json.loads((tmp_path / "s.json").read_text())
    with (tmp_path / "s.csv").open() as file:
        rows = [[float(v) for v in row.values()] for row in csv.DictReader(file)]
    assert rows == content["xyt"]
    np.testing.assert_allclose(content["samples"]["mean_xyt"], np.mean(rows, axis=0))
    np.testing.assert_allclose(content["samples"]["covariance"], np.cov(np.transpose(rows)))


def test_article_code_says_what_it_means(capsys):
    assert run(["sample", "-v", "--law", "article-code", "--seed", "1"]) == 0
    assert "sd*sd" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["sample", "-o", "x.gif"], ".gif"),
        (["sample", "--end", "1,2"], "x,y,heading"),
        (["sample", "--end", "1deg,2,3"], "x,y,heading"),
        (["sample", "--example", "nope"], "balanced"),
        (["sample", "--example", "balanced", "--preset", "typical"], "has its own noise"),
        (["sample", "--effect", "wheel_scale:e=0.01"], "duration"),
        (["sample", "--law", "quadratic"], "--alpha"),
        (["sample", "--law", "article-code", "--preset", "typical"], "--alpha"),
        (["density", "--alpha", "0", "0", "0.1", "0.1"], "rot1"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "quadratic", "--to", "diffusion"], "--step"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "diffusion", "--to", "linear"], "--to-step"),
        (["convert-alpha", "1", "1", "1", "--from", "diffusion", "--to", "linear"], "3 numbers"),
        (["convert-alpha", "1", "1", "1", "x", "--from", "diffusion", "--to", "linear"], "'x'"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "cubic", "--to", "linear"], "cubic"),
    ],
)
def test_wrong_usage_is_reported_in_one_line(arguments, word, capsys):
    assert run(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]


def test_start_alone_moves_the_examples_motion(capsys):
    parts = []
    for start in ([], ["--start", "5,-3,0.1"]):
        assert run(["sample", "--seed", "1", "--json", *start]) == 0
        content = json.loads(capsys.readouterr().out)
        parts.append([content[name] for name in ("rot1_rad", "trans_m", "rot2_rad")])
    np.testing.assert_allclose(parts[0], parts[1], atol=1e-12)


def test_density_is_printed_and_drawn(tmp_path, capsys):
    picture = tmp_path / "density.svg"
    assert run(["density", "-o", str(picture), "--seed", "1", "--at", "0.2,0.35,10deg"]) == 0
    out = capsys.readouterr().out
    integral = float(re.search(r"end poses: ([\d.]+)", out)[1])
    assert integral == pytest.approx(1.0, abs=1e-3)
    assert float(re.search(r"10 deg\): ([\d.]+)", out)[1]) > 100
    assert picture.read_bytes().startswith(b"<?xml")
