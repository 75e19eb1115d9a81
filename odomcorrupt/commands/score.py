"""odomcorrupt score: errors of a localisation on the runs of a batch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import unpack_option
from odomcorrupt.commands._options import OUTPUT, PAGE, PICTURE, PICTURES, OutputFile, kind_of, number, setting, valued
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, overwrite_option, printed, standard_options, typed_words, written
from odomcorrupt.input_files import read_input


@click.command("score", short_help="Score a localisation over the runs of a batch; a gate for CI.")
@click.argument(
    "runs", metavar="RUNS...", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@setting("--estimate", metavar="TOPIC", help="Topic of the estimate, or an edge of TF as /tf:map.base_link.")
@click.option(
    "--outputs", type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Where the estimates are: bags, TUM or CSV files named after the runs. [default: beside the runs]",
)  # fmt: skip
@setting("--truth", metavar="TOPIC", help="Topic or edge of TF. [default: the odometry before it was corrupted]")
@click.option("--truth-bag", type=click.Path(exists=True, path_type=Path), help="Bag, TUM or CSV with the truth.")
@valued(
    "--align",
    among=["rigid", "origin", "none", "same"],
    text="Align estimate and truth: best fit of positions, equal first poses, none (both in one frame), or none "
    "although their frames have different names (same).",
)
@valued(
    "--lost", "lost_m", kind=number("metres", 0.0, 1e6), default=1.0,
    text="Position error beyond which a run is lost, metres.",
)  # fmt: skip
@valued(
    "--lost-for", "lost_s", kind=number("seconds", 0.0, 1e6), default=10.0,
    text="Time that such an error must last, seconds (or until the end).",
)  # fmt: skip
@valued(
    "--jump", "jump_m", kind=number("metres", 0.0, 1e6), default=0.5,
    text="Change of the error within a second that is a jump, metres.",
)  # fmt: skip
@click.option("--count-missing", is_flag=True, hidden=True, expose_value=False)
@click.option(
    "--baseline", multiple=True, type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Result of an earlier --save, to compare with; of several, the median of each run (repeatable).",
)  # fmt: skip
@click.option(
    "--fail-if", "rules", multiple=True, metavar="RULE",
    help='Exit with 1 on a significant rise, "ate_p90 +20%", or beyond a bound, "lost +1", "ate > 0.3" (repeatable).',
)  # fmt: skip
@click.option("--save", type=OUTPUT, help="Write the result as JSON: a baseline for later.")
@click.option("-o", "--output", type=OutputFile("json", *PICTURES), help="The same as --save, or as --plot.")
@click.option("--report", type=PAGE, help="Write the full result as one HTML page.")
@click.option("--markdown", type=OUTPUT, help="Write gate and tables as Markdown, for a summary page of CI.")
@click.option("--junit", type=OUTPUT, help="Write the gate as JUnit XML, a test case for each rule.")
@click.option("--csv", type=OUTPUT, help="Write the table of points of a sweep: drift, runs, lost, median and p90.")
@click.option("--plot", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@overwrite_option("existing outputs")
@unpack_option
@standard_options
def command(runs: tuple[Path, ...], *, console: Console, **given: Any) -> int:
    """Print errors of a localisation that was run on each bag of a batch, against the drift of its odometry.

    Estimates are in the runs themselves, or in files of --outputs that begin like the runs (run_000012_amcl.mcap).
    """
    from odomcorrupt.api.score import score
    from odomcorrupt.report.score import gate_lines
    from odomcorrupt.scoring.errors import Limits
    from odomcorrupt.scoring.gate import parse_rule

    if given["baseline"] and not given["rules"]:
        raise click.UsageError('--baseline: is for a gate; give a rule, as in --fail-if "ate_p90 +20%"')
    for rule in given["rules"]:
        parse_rule(rule)
    baseline = [_baseline(path) for path in given["baseline"]]
    with Stages("scoring", quiet=console.quiet):
        result = score(
            runs, given["estimate"], truth=given["truth"], truth_bag=given["truth_bag"],
            outputs=given["outputs"], align=given["align"],
            limits=Limits(given["lost_m"], given["lost_s"], given["jump_m"]),
        ).check(given["rules"], baseline)  # fmt: skip
    if console.as_json:
        for line in gate_lines(result.verdicts):
            click.echo(line, err=True)
    drawn = given["output"] is not None and kind_of(given["output"]) in PICTURES

    def as_json() -> str:
        return json.dumps(result.to_dict(), indent=1, allow_nan=False) + "\n"

    files = {
        **printed(given["save"], as_json), **printed(None if drawn else given["output"], as_json),
        **printed(given["report"], result.report), **printed(given["markdown"], result.markdown),
        **printed(given["junit"], result.junit), **printed(given["csv"], result.points_csv),
        **written(given["plot"], result.plot), **written(given["output"] if drawn else None, result.plot),
    }  # fmt: skip
    following = () if given["report"] else ("odomcorrupt", "score", *typed_words(), "--report", "page.html")
    console.show(result.then(*following), files=files)
    return 1 if result.failed else 0


def _baseline(path: Path) -> dict[str, Any]:
    from odomcorrupt.scoring.errors import ScoreError

    text = read_input(path, 1 << 28, "result of score", ScoreError)
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ScoreError(f"{path}: is not JSON; make a baseline with odomcorrupt score ... --save") from error
    if not isinstance(table, dict) or "runs" not in table:
        raise ScoreError(f"{path}: is not a result of score; make a baseline with odomcorrupt score ... --save")
    return table
