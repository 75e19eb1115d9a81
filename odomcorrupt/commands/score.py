"""odomcorrupt score: errors of a localisation on the runs of a batch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import unpack_option
from odomcorrupt.commands._options import OUTPUT, PAGE, PICTURE, Number, one_of, setting
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, written
from odomcorrupt.input_files import read_input
from odomcorrupt.result_files import write_text

_BASELINE_BYTES = 1 << 28


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
@one_of(
    "--align",
    among=["rigid", "origin", "none"],
    text="Align estimate and truth: best fit of positions, equal first poses, or none.",
)
@click.option(
    "--lost",
    "lost_m",
    type=Number("metres", 0.0, 1e6),
    default=1.0,
    help="Position error beyond which a run is lost, metres. [default: 1]",
)
@click.option(
    "--lost-for",
    "lost_s",
    type=Number("seconds", 0.0, 1e6),
    default=10.0,
    help="Time that such an error must last, seconds (or until the end). [default: 10]",
)
@click.option(
    "--jump",
    "jump_m",
    type=Number("metres", 0.0, 1e6),
    default=0.5,
    help="Change of the error within a second that is a jump, metres. [default: 0.5]",
)
@click.option("--count-missing", is_flag=True, help="Count runs without a complete output as failures.")
@click.option(
    "--baseline",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Result of an earlier --save, to compare with.",
)
@click.option(
    "--fail-if", "rules", multiple=True, metavar="RULE",
    help='Exit with 1 if this rule holds, as in "ate_p90 +20%", "lost +5%", "ate_median > 0.3" (repeatable).',
)  # fmt: skip
@click.option("--each", is_flag=True, help="Print a line for every run, not only for those that failed.")
@click.option("--save", type=OUTPUT, help="Write the result as JSON: a baseline for later.")
@click.option("--report", type=PAGE, help="Write the full result as one HTML page.")
@click.option("-o", "--output", type=PICTURE, help="Picture to write: png, svg or pdf.")
@overwrite_option("existing outputs")
@unpack_option
@standard_options
def command(runs: tuple[Path, ...], *, console: Console, **given: Any) -> int:
    """Print errors of a localisation that was run on each bag of a batch, against the drift of its odometry.

    Estimates are in the runs themselves, or in files of --outputs that begin like the runs (run_000012_amcl.mcap).
    """
    from odomcorrupt.api.score import score
    from odomcorrupt.scoring.errors import Limits
    from odomcorrupt.scoring.gate import parse_rule

    if given["baseline"] is not None and not given["rules"]:
        raise click.UsageError('--baseline: is for a gate; give a rule, as in --fail-if "ate_p90 +20%"')
    for rule in given["rules"]:
        parse_rule(rule)
    baseline = None if given["baseline"] is None else _baseline(given["baseline"])
    with Stages("scoring", quiet=console.quiet):
        result = score(
            runs, given["estimate"], truth=given["truth"], truth_bag=given["truth_bag"],
            outputs=given["outputs"], align=given["align"], count_missing=given["count_missing"],
            limits=Limits(given["lost_m"], given["lost_s"], given["jump_m"]),
        ).check(given["rules"], baseline)  # fmt: skip
    if console.as_json:
        for verdict in result.verdicts:
            click.echo(f"{verdict.sentence}.", err=True)
    values, details = result.to_dict(), result.details()
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    files = {
        **written(given["save"], lambda path: write_text(path, text)),
        **written(given["report"], lambda path: write_text(path, result.report())),
        **written(given["output"], result.plot),
    }
    console.print(details if given["each"] else result.summary(), details, values, files=files)
    return 1 if result.failed else 0


def _baseline(path: Path) -> dict[str, Any]:
    from odomcorrupt.scoring.errors import ScoreError

    text = read_input(path, _BASELINE_BYTES, "result of score", ScoreError)
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ScoreError(f"{path}: is not JSON; make a baseline with odomcorrupt score ... --save") from error
    if not isinstance(table, dict) or "runs" not in table:
        raise ScoreError(f"{path}: is not a result of score; make a baseline with odomcorrupt score ... --save")
    return table
