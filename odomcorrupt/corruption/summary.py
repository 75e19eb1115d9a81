"""Lines of a run's result, and their sentences."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from typing import TYPE_CHECKING

from odomcorrupt.corruption.inverse import changes_nothing
from odomcorrupt.corruption.odometry_source import ODOMETRY, last_part, localisation_words, plain, says_truth
from odomcorrupt.corruption.path import LEG_M
from odomcorrupt.corruption.pose_faults import frame_faults
from odomcorrupt.effects.effect import choices, parameters
from odomcorrupt.model.presets import DEFAULT, suggested
from odomcorrupt.summary import FIRST, FOUND, Line, Summary, Tone, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.corruption.path import Drift
    from odomcorrupt.corruption.run import Outcome
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel, Noise

SIDEWAYS = 0.1
"""A robot that goes this part of its way to the left or right is holonomic."""

STRAIGHT = 0.001
"""One that goes less than this part of its way so is not."""


MOST_EDGES = 6
"""More need not be named."""

LOST_RAD = 1.0
"""Beyond this deviation of the heading a forecast to first order says nothing about positions."""


def brief(outcome: Outcome, origin: str, target: str, remarks: Sequence[str] = ()) -> Summary:
    """Return the summary of a run: final drift, model, seed, moved topics, warnings.

    outcome : result of the run
    origin : source of the model's numbers, in words
    target : the output; "-" is a pipe
    remarks : further warnings, such as that the input was corrupted before
    """
    drift, is_identity = outcome.drift, changes_nothing(outcome.model) and not outcome.changes.noisy
    model = model_brief(outcome.model, origin.partition(":")[0])
    lines = [Line("UNCHANGED", "the model has no noise or effect that changes odometry", "warning")]
    if not is_identity:
        noise = "" if outcome.model.noise.coefficients.noise_free else " (noise: {})"
        said = f"{size_words(drift.end_drawn_m, drift.end_drawn_rad)} off after {drift.distance_m:.4g} m"
        said += noise.format(_expected(drift.end_expected_m, drift.end_expected_rad))
        leg = leg_words(drift) + noise.format(_leg(drift)) * bool(leg_words(drift))
        lines = [Line("MOVED", said, "good", full=said + leg)]
    lines.append(Line("model", "" if is_identity else model, full=model_words(outcome.model, origin)))
    faster = [Line("faster", sentence, "warning") for sentence in _faster(drift)]
    lines[1:1] = [*lost_lines(outcome), *faster, *places_lines(outcome.model, outcome.frames.odom)]
    lines.append(Line("seed", f"{outcome.seed}, run {outcome.run}", weight=FOUND))
    lines.append(odometry_line(outcome, "plain" if outcome.changes.edges or outcome.added else "warning"))
    lines += [
        Line("also", f"{moved_words(other)}: {size_words(other.drift.end_drawn_m, other.drift.end_drawn_rad)} off")
        for other in outcome.others
    ]
    odd = [sentence for sentence in oddities(outcome) if not sentence.startswith("Lost: ")]
    true = outcome.with_true_motion
    lines += [Line("note", remark, "warning", FOUND) for remark in remarks if remark]
    named = suggested([*outcome.stayed, *(name for c in outcome.channels for name in (c.topic, c.msgtype))])
    if named and outcome.model.source.get("preset") == DEFAULT:
        lines.append(Line("note", f"looks like a {named}: --preset {named} has its numbers", "warning"))
    if true and not is_identity:
        lines.append(leaks_line(true))
    lines += [Line("anomaly", sentence, "warning", weight=FOUND) for sentence in odd]
    if not is_identity and not outcome.added:
        stays = localisation_words(outcome.stayed, outcome.frames, outcome.channels)
        lines += [Line("note", said, "warning", FOUND, said.partition(" and localise")[0]) for said in stays]
    if not is_identity:
        said = "the drift depends on the message rate: see --step and --law diffusion"
        lines += [Line("rate", said, "warning", full=sentence) for sentence in _rate(outcome)]
    following = () if target == "-" else (command_line(["odomcorrupt", "info", target]),)
    return Summary((*lines, *following))


def leaks_line(topics: Sequence[str]) -> Line:
    """Return a warning that names the unmodified topics from which a filter can still read the true motion."""
    verb = "contains" if len(topics) == 1 else "contain"
    return Line("leaks", f"{', '.join(topics)}: still {verb} the true motion", "warning")


def lost_lines(outcome: Outcome) -> list[Line]:
    """Return what recovery lost, on one line, or none: short, and above what may be left out of a summary."""
    if not outcome.losses:
        return []
    _, _, first = outcome.losses[0].partition(": ")  # behind the name of the file
    more = f" (and {len(outcome.losses) - 1} more: -v shows all)" if len(outcome.losses) > 1 else ""
    # characters of what is lost that a summary shows
    return [
        Line(
            "LOST",
            textwrap.shorten(first, 120, placeholder=" ...") + more,
            "bad",
            FIRST,
            full="; ".join(outcome.losses),
        )
    ]


def places_lines(model: MotionModel, frame: str = "odom") -> list[Line]:
    """Return a line on effects of places, which were learned in a truth's frame and act in the odometry's, or none."""
    names = ", ".join(effect.name for effect in model.placed)
    said = f"{names}: learned in the frame of a truth, and acts at places and headings of the frame {frame}"
    return [Line("places", said, "warning")] if names else []


def topic_words(outcome: Outcome) -> str:
    """Return that the model was learned from this topic, where a bag has others, or nothing."""
    topics = {channel.topic for channel in outcome.channels if channel.msgtype == ODOMETRY}
    others = ", ".join(sorted(topic for topic in topics if plain(topic) != plain(outcome.odometry)))
    if not others or plain(outcome.odometry) != plain(outcome.model.odometry_topic or ""):
        return ""
    return f" (the topic that the model was learned from; not {others})"


def moved_words(outcome: Outcome, *, full: bool = False) -> str:
    """Return the moved topics and edges with their numbers of messages, as text.

    full : whether the edges of TF are named where none was moved: the odom frame may be wrong
    """
    changes, stayed = outcome.changes, sorted(outcome.stayed)
    topics = [f"{topic} {count}" for topic, count in sorted(changes.odometry.items())]
    topics += [f"{topic} consistent with it" for topic in sorted(changes.sensors)]
    topics += [f"{topic} {count} with noise" for topic, count in sorted(changes.noisy.items())]
    topics += [f"{topic} {count} scans kept" for topic, count in sorted(outcome.scans.items())]
    edges = [f"TF {edge} {count}" for edge, count in sorted(changes.edges.items())]
    more = f" and {len(stayed) - MOST_EDGES} more" if len(stayed) > MOST_EDGES else ""
    seen = f" (TF has {', '.join(stayed[:MOST_EDGES])}{more})" if stayed and full else ""
    none = [] if edges or outcome.added else [f"no transform from {outcome.frames.odom}{seen}"]
    return ", ".join([*topics, *edges, *none, *(f"{count} {what} added" for what, count in outcome.added.items())])


def odometry_line(outcome: Outcome, tone: Tone = "plain") -> Line:
    """Return the line of what was moved, and in full by the poses of which odometry, with its length."""
    topic = topic_words(outcome)
    way = f"{outcome.drift.distance_m:.4g} m in {outcome.drift.duration_s:.4g} s"
    source = f"computed from the poses of {outcome.odometry}{topic} ({way})"
    return Line("odometry", moved_words(outcome) + topic, tone, full=f"{moved_words(outcome, full=True)}, {source}")


def model_words(model: MotionModel, origin: str) -> str:
    """Return noise law, coefficients, their source, and effects, as text."""
    noise = model.noise
    values = dataclasses.asdict(noise.coefficients).items()
    numbers = " ".join(f"{name} {value:.4g}" for name, value in values if value or name in noise.law.alphas)
    words = "No noise" if noise.coefficients.noise_free else f"Law {noise.law_name}, {numbers}"
    words += f", once per {noise.step}" if noise.step is not None else ""
    words += f" ({origin})" if origin else ""
    effects = [effect_words(effect) for effect in model.effects if effect.acts]
    return words + (f"; effects {', '.join(effects)}" if effects else "")


def model_brief(model: MotionModel, origin: str) -> str:
    """Return noise law, alphas as typed, their source, and effects, as text."""
    noise = model.noise
    alphas = [getattr(noise.coefficients, name) for name in noise.law.alphas]
    while len(alphas) > 4 and not alphas[-1]:
        alphas.pop()
    words = f"{noise.law_name}, alpha {' '.join(f'{value:.3g}' for value in alphas)}" if any(alphas) else "no alphas"
    if noise.coefficients.white_v or noise.coefficients.white_omega:
        words += f", twist noise {noise.coefficients.white_v:.3g} {noise.coefficients.white_omega:.3g}"
    words += f", angle random walk {noise.coefficients.rot_time:.3g}" if noise.coefficients.rot_time else ""
    words += f", once per {noise.step}" if noise.step is not None else ""
    words += f" ({origin})" if origin else ""
    return ", ".join([words, *(effect_words(effect) for effect in model.effects if effect.acts)])


def effect_words(effect: Effect) -> str:
    """Return an effect's name with its parameters and units, and the choices that are not the usual ones."""
    values = [f"{p.name} {getattr(effect, p.name):.4g} {p.unit}".rstrip() for p in parameters(effect)]
    # a heading from the wheels goes without saying
    said = ((word, getattr(effect, word), options[0]) for word, options in choices(effect).items())
    values += [f"{word} {value}" for word, value, usual in said if value != usual]
    return f"{effect.name} ({', '.join(values)})"


def leg_words(drift: Drift) -> str:
    """Return the drift per leg, after that at the end; "" for a drive without one."""
    if drift.leg_drawn_m is None or drift.leg_drawn_rad is None:
        return ""
    return f"; per {LEG_M:.0f} m {size_words(drift.leg_drawn_m, drift.leg_drawn_rad)}"


def _leg(drift: Drift) -> str:
    return _expected(drift.leg_expected_m or 0.0, drift.leg_expected_rad or 0.0)


def _expected(metres: float, radians: float) -> str:
    """Return the expected drift as text; without the position where the heading error is too large for first order."""
    known = radians < LOST_RAD
    return size_words(metres, radians) if known else f"{math.degrees(radians):.3g} deg: the position is arbitrary"


def size_words(metres: float, radians: float) -> str:
    """Return a displacement and a turn as text, metres and degrees."""
    return f"{metres:.3g} m, {math.degrees(radians):.3g} deg"


def _faster(drift: Drift) -> list[str]:
    """Return a warning where the drive is faster than the learned effects have an inverse for."""
    if not (drift.slowed_s and drift.slowed_to):
        return []
    more = f"{100.0 * (1.0 / drift.slowed_to - 1.0):.2g} % faster than the model's highest valid speed"
    return [f"For {drift.slowed_s:.2g} s up to {more}: the relative error is kept constant."]


def per_message(noise: Noise) -> list[str]:
    """Return the parts of a noise that act once per message, so that the drift depends on the message rate."""
    white = bool(noise.coefficients.white_v or noise.coefficients.white_omega)
    return [f"the law {noise.law_name}"] * noise.law_per_message + ["white noise on twists"] * white


def _rate(outcome: Outcome) -> list[str]:
    """Return a warning where the drift depends on the message rate."""
    drift = outcome.drift
    what = per_message(outcome.model.noise)
    if not what or drift.rate_hz is None:
        return []
    means = f"a drift of {_leg(drift)} per {LEG_M:.0f} m" if drift.leg_expected_m is not None else "the drift above"
    here = f"these numbers mean {means} at this bag's {drift.rate_hz:.3g} Hz, and other values at another rate"
    way_out = "; --step 0.25m,0.2rad or --law diffusion do not depend on it" * what[0].startswith("the law")
    return [f"Once per message acts {' and '.join(what)}: {here}{way_out}."]


def holonomic_words(model: MotionModel, sideways_m: float, distance_m: float) -> list[str]:
    """Return a warning, one sentence or none, where noise law and robot disagree about sideways motion.

    model : its noise law may assume sideways motion
    sideways_m, distance_m : lateral and total travel of the drive, metres
    """
    law = model.noise.law
    if law.along_travel and not model.noise.coefficients.noise_free and sideways_m < STRAIGHT * distance_m:
        return [f"The law {law.name} is for robots that move sideways, but this one does not; leave --law out."]
    if law.along_travel or sideways_m <= SIDEWAYS * distance_m:
        return []
    way = f"{sideways_m:.3g} m of {distance_m:.3g} m"
    return [f"The robot moves sideways ({way}), which the law {law.name} does not model; --law omni does."]


def oddities(outcome: Outcome) -> list[str]:
    """Return warnings about the bag and what could not be read of it."""
    drift = outcome.drift
    said = holonomic_words(outcome.model, drift.sideways_m, drift.distance_m)
    if outcome.faults.zero_stamps:
        said.append(f"{outcome.faults.zero_stamps} odometry stamps are zero: log times were used instead.")
    if outcome.order.swapped:
        said.append(f"{outcome.order.swapped} odometry messages were out of order: they were sorted.")
    said += stream_oddities(
        outcome, follow="the drift", restart="each time the drift began again at zero", late="no noise of their own"
    )
    if says_truth(outcome.odometry) and not outcome.added:
        said.append(
            f"{outcome.odometry} is named like a ground truth, and the output has no true poses: --keep-truth TOPIC "
            "keeps a clean copy."
        )
    edges = [tuple(edge.split(" -> ", 1)) for edge in (*outcome.changes.edges, *outcome.stayed) if " -> " in edge]
    paths = sorted(outcome.changes.paths.items())
    said[:0] = [f"TF {edge}: {path.sentence()}; record the TF of one alone." for edge, path in paths if path.alternates]
    tree = frame_faults([(above, below) for above, below in edges], outcome.frames.odom, outcome.frames.base)
    said += [f"{sentence[0].upper()}{sentence[1:]}." for sentence in tree]
    return said + _same_edge(outcome)


def _same_edge(outcome: Outcome) -> list[str]:
    """Return a warning where TF has the odometry's edge under other prefixes, and was not moved."""
    ends = outcome.frames
    if ends.base is None or outcome.changes.edges:
        return []
    last = [last_part(frame) for frame in (ends.odom, ends.base)]
    for edge in sorted(outcome.stayed):
        odom, base = edge.split(" -> ", 1)
        if [last_part(odom), last_part(base)] == last:
            said = f"TF {edge} still contains the true motion: the odometry is from {ends.odom} to {ends.base}; "
            return [f"{said}--odom-frame {odom} --base-frame {base} moves both."]
    return []


def stream_oddities(outcome: Outcome, *, follow: str, restart: str, late: str) -> list[str]:
    """Return warnings about static transforms, losses, and stamps and poses of the odometry that are out of order.

    outcome : result of the run
    follow : what a static transform cannot follow
    restart : what happened where time jumped back
    late : how messages were treated that came too late, or whose stamps lie far ahead
    """
    changes, order = outcome.changes, outcome.order
    numberless = outcome.unusable - outcome.faults.far - outcome.faults.no_orientation
    counted = {
        f"The correction was held for {changes.held} of these, beyond the odometry's last stamp.": changes.held,
        f"Time jumped back {order.restarts} times: {restart}.": order.restarts,
        f"The pose jumped {outcome.drift.jumps} times: the correction was held across.": outcome.drift.jumps,
        f"{order.late} odometry messages came more than a second late: moved, but {late}.": order.late,
        f"{order.leaps} odometry stamps lie far ahead of their neighbours': {late}.": order.leaps,
        f"{numberless} odometry poses are not numbers: left unchanged.": numberless,
    }
    static = [
        f"/tf_static holds {edge}: published once for all time, it cannot follow {follow}."
        for edge in sorted(changes.static)
    ]
    static += [
        f"Twists of {topic} are in the axes of {outcome.frames.odom}, not of the child frame: changed in these."
        for topic in sorted(changes.odom_axes)
    ]
    static += [*(f"Lost: {loss}." for loss in outcome.losses), *(f"{remark}." for remark in outcome.remarks)]
    said = [*static, *(sentence for sentence, count in counted.items() if count > 0)]
    return [*said, *(f"{fault[0].upper()}{fault[1:]}." for fault in outcome.faults.sentences())]
