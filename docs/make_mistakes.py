"""Write the page of plain mistakes, docs/how-to/mistakes.md, from the table in `study/io/first_look.py`."""

from __future__ import annotations

from pathlib import Path

from odomcorrupt.study.io.first_look import COMMANDS, OF_COURSES, PATTERNS, THRESHOLDS

PAGE = Path(__file__).parent / "how-to" / "mistakes.md"
HEAD = """# Plain mistakes

A wheel wired backwards, a track in centimetres, forward that is -x: before any statistics `learn`, `diagnose`, `fit`
and `compare` compare sums of the motion over about a second in odometry and truth, and each trajectory with itself.
What is wrong is the first line, with its figures:

    odomcorrupt learn drive.mcap -o robot.toml

    MISTAKE  /odom turns 10 times as far as the truth, left and right alike; travel agrees
    causes   wheel separation (or steering ratio, or gyro scale) wrong by this factor
    change   `wheel_separation` x 10; the model has the factor, and is of this odometry as it is

Mend it and record again. Meanwhile signs, axes and units are undone and the study goes on with the rest; factors are
parts of the model, however large, so that `correct` undoes them in these bags (of single wheels they are undone). Where
nothing can be learned, the command ends with that line and exit code 1. `info` names the rows marked (alone) without a
truth.

A truth whose headings never change (a receiver of satellites that fills in no orientation) is one of positions alone.
Of odometry and truth the one is wrong that contradicts itself, or else the one that a gyro in the bag contradicts (its
z axis up), or the odometry if its own wheel joints do. If nothing decides, both are named.

The rows are tested in this order, and each is undone before the next test:

| what is seen | usual causes | change | how the study goes on |
|---|---|---|---|
"""
COURSES_HEAD = """

A path and its headings contradict each other in these ways. The one that turns otherwise than the other trajectory is
wrong:

| the path turns | usual causes, if its headings are wrong | if its path is |
|---|---|---|
"""


def thresholds(kind: str) -> dict[str, str]:
    """Return causes and change of a limit or a dead zone, of the odometry and of the truth."""
    both = zip(("causes", "change"), zip(THRESHOLDS[kind], COMMANDS[kind], strict=True), strict=True)
    return {word: "; or, if it is that of the truth: ".join(said) for word, said in both}


FIGURES = {
    "who": "/odom", "other": "/truth", "count": 100, "size": "0.944 m", "speed": 310,
    "factor": 0.0175, "plane": "x-z", "up": "y", "what": "never change", "off": 12.0,
    "side": "left", "best": 0.9, "near": 0.1, "shift": 12.0, "corr": -1,
    "fault": "whether the odometry or the truth is wrong, these data do not show", "share": "6%",
    "how": "drives forwards there", "far": 1000, "few": 8,
    "travels": "3.3 times as far as", "turns": "10 times as far as", "hint": "", "v": 0.303,
    "rate": 0.5, "doubt": "", "lost": 60, "each": "that count left -1.00, right 1.00 times their way",
    "explained": "99.8%",
    "cause": "a wheel counts the wrong way (its channels are exchanged), counts nothing, or by another factor",
    "change": "negate the counts of that wheel, or multiply them", "then": "this is undone in the odometry",
    "most": 160, "hint_turn": "", "separation": 10, "agree": "turns agree", "track": " (0.016 -> 0.16 m)",
    "sides": ", left and right alike", "truth": "",
}  # fmt: skip
"""Example of each figure."""
OWN = {
    "steps and headings": {
        "times": "57.3 times as far as", "which": ", and its headings turn as /truth",
        "causes": "x += v cos(yaw) dt with yaw in degrees; others below",
        "then": "its headings are multiplied, or its path is made again of its steps and headings",
    },
    "sign": {"does": "counts its wheels in reverse forwards", "share": "29%",
             "causes": "encoders without direction (one channel, or a counter that cannot count down); unsigned speeds "
             "or yaw rates; a yaw rate of the absolute speed; the cosine of a steering angle is left out",
             "change": "count both channels, give speeds a sign"},
    "overflow": {"cause": "a counter overflows (often of 8 or 16 bits), is read as unsigned, or is reset at stops; "
                          "once a second, a time step is taken from the nanoseconds alone"},
    "slow turns": {"rate": 26},
    "resets": {"where": "4.99 m at 77 s", "causes": "the node or the board was restarted; a counter was reset; counts "
               "or speeds are read as unsigned"},
    "flips": {"how": "while its path goes on"},
    "limit": {"one": "/odom", "beside": "the truth", "what": "speeds of its wheels", "at": "0.45 m/s", "share": "71%"}
    | thresholds("limit"),
    "dead zone": {"one": "/odom", "beside": "the truth", "what": "yaw rates", "at": "0.23 rad/s", "share": "35%"}
    | thresholds("dead zone"),
    "time step": {"step": 20, "low": 20, "high": 60}, "publishers": {"share": "67%", "few": 8},
    "clamped headings": {"share": "17%"},
    "other way round": {"count": 2},
    "late turns": {"late": 1.5, "side": "later"}, "stretched": {"who": "/truth", "factor": 1.62, "along": 0},
    "plane": {"who": "/truth"}, "headings of the truth": {"who": "/truth", "what": "are 0 or 180 deg alone"},
    "clock rate": {"factor": 2.0},
    "stands still": {"share": "50%", "causes": "a driver that lost its wheels, and repeats a message; a robot that is "
                     "blocked while its wheels spin, or beside odometry of commands; a tracker that lost its target"},
    "whole steps": {"steps": "increments are whole steps of 1 mm of a wheel", "lost": "travels 0.9 +- 0.1"},
    "stamps": {"note": "/odom: 4341 of its poses have the stamp of the one before, while it moves, or stamps read as "
               "milliseconds beside seconds"},
    "turns too far": {"usual": 4, "causes": "wheel separation, or radius, in other units; degrees for radians"},
    "Euler steps": {"at": "beginning", "most": 22},
    "sideways": {"how": "moves sideways the other way than"}, "late clock": {"who": "/truth", "side": "behind"},
    "turned axes": {"angle": 45},
    "unit of lengths": {"unit": "millimetres"},
    "one heading": {"when": "from 70 s to 180 s", "does": "has one heading"},
}  # fmt: skip
"""Examples of single rows."""


def page() -> str:
    """Return the page in Markdown."""
    rows = []
    for pattern in PATTERNS:
        figures = FIGURES | OWN.get(pattern.name, {})
        seen, causes, change, then = (
            text.format(**figures) for text in (pattern.seen, pattern.causes, pattern.change, pattern.then)
        )
        rows.append(f"| {seen}{' (alone)' if pattern.alone else ''} | {causes} | {change} | {then or 'it ends here'} |")
    courses = (
        f"| {times} its headings | {' | '.join(one or '-' for one in said)} |"
        for times, *said in list(OF_COURSES.values())[1:]
    )
    return HEAD + "\n".join(rows) + COURSES_HEAD + "\n".join(courses) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf8")
