"""`odomcorrupt compare` prints, draws, judges, and never overwrites."""

import json

import pytest

from odomcorrupt.cli import run
from odomcorrupt.commands.compare import REJECTED


def compare(case, *more) -> int:
    return run(["compare", str(case.bag), *map(str, more)])


def test_it_prints_horizons_verdicts_and_sentences(case, capsys):
    assert compare(case, "-v", case.base, case.robot) == 0
    out = capsys.readouterr().out
    said = ("NEES", "base.toml is rejected", "the odometry turns too far left", "nats/m", "RPE over 1 m", "Signs")
    assert [words for words in said if words not in out] == []


def test_a_preset_is_a_model_of_compare_diagnose_and_fit(case, capsys):
    assert compare(case, "bad") == 0
    said = capsys.readouterr().out
    assert said.replace("\\\n", " ").split()[-3:] in (
        ["noisy.bag", "--preset", "bad"],
        ["diagnose", str(case.bag), "bad"],
    )
    assert run(["diagnose", str(case.bag), "bad", "-q"]) == 0
    assert run(["fit", str(case.bag), "--start", "bad", "-q"]) == 0


def test_json_has_the_numbers_behind_and_a_rejected_model_fails_where_that_is_asked_for(case, capsys):
    assert compare(case, case.base, "--json", "--fail-if-rejected") == REJECTED == 4
    model = json.loads(capsys.readouterr().out)["models"][0]
    assert model["verdict"]["rejected"] is True
    assert model["verdict"]["threshold"] == pytest.approx(model["verdict"]["level"] / len(model["verdict"]["checks"]))
    assert [h["distance_m"] for h in model["horizons"]][:4] == [1.0, 2.0, 5.0, 10.0]
    first = model["horizons"][0]
    assert set(first["coverage_50"]) == {"along", "across", "yaw"}
    assert first["crps"]["yaw_rad"] > 0.0
    grows = next(f for f in model["fails"] if f["kind"] == "motion")
    assert (grows["channel"], grows["unit"]) == ("yaw", "rad/m")
    assert grows["measured"] > grows["expected"] > 0.0


@pytest.mark.slow
def test_report_and_pictures_are_written_once(case, tmp_path, capsys):
    report, error, where = tmp_path / "out.html", tmp_path / "error.png", tmp_path / "map.svg"
    wanted = (case.robot, "--report", report, "--plot", error, "--plot", f"map={where}")
    assert compare(case, *wanted) == 0
    assert report.read_text().startswith("<!DOCTYPE html>")
    assert error.read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in where.read_bytes()[:1000]
    before = report.stat().st_mtime_ns
    capsys.readouterr()
    for again in (("--report", report), ("--plot", f"nees={error}")):
        assert compare(case, case.robot, *again) == 1
        assert "--overwrite" in capsys.readouterr().err
    assert report.stat().st_mtime_ns == before
    assert compare(case, case.robot, "--plot", error, "--overwrite", "--fail-if-rejected") == 0


@pytest.mark.parametrize(
    ("plots", "words"),
    [
        (["cloud=a.png"], "there are error, path"),
        (["error=a.bmp"], "a.bmp: ends in .bmp; write .png"),
        (["a"], "a: ends in nothing; write .png"),
        (["a.png", "nees=a.png"], "another picture"),
    ],
)
def test_a_picture_that_is_not_there_is_named_and_two_do_not_share_a_file(
    case, tmp_path, capsys, monkeypatch, plots, words
):
    monkeypatch.chdir(tmp_path)
    assert compare(case, case.robot, *(word for plot in plots for word in ("--plot", plot))) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "word"), [("base", "diagnose"), ("robot", "sim.bag")])
def test_a_verdict_ends_with_what_to_type_next(case, capsys, name, word):
    """A rejected model is to be diagnosed, and one that holds to be used."""
    assert compare(case, getattr(case, name)) == 0
    lines = capsys.readouterr().out.splitlines()
    (first,) = [i for i, line in enumerate(lines) if line.startswith("next")]
    assert lines[first].split()[:3] == ["next", "odomcorrupt", word]
    assert lines[-1].split()[-1] == str(getattr(case, name))
