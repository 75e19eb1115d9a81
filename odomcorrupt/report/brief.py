"""Findings and fit of a study in eight lines: verdict, sizes, held-out errors, what stays open, next command."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, isfinite, radians
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.export import WHEEL_EFFECTS, wheel_multipliers
from odomcorrupt.report.comparison import HELD, TONES, measures_words, plainly, reproduction_sentence, size
from odomcorrupt.report.findings import (
    GROSS,
    SIGNIFICANT,
    alternative,
    are_doubtful,
    clock_text,
    clocks_found,
    confidence_words,
    contradiction,
    dependences_found,
    effects_found,
    effects_with_errors,
    foremost,
    groups_words,
    inseparable_sentence,
    is_unexplained,
    noise_found,
    numbers_text,
)
from odomcorrupt.study.estimate.drive_type import readings_of
from odomcorrupt.study.select.confidence import EVEN_ODDS
from odomcorrupt.study.validate.compare import agreement_of
from odomcorrupt.summary import ALWAYS, FIRST, FOUND, SPARE, USUAL, Line, Summary, Tone

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.report.findings import Found, FoundDependence
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Mistake
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.predictive_check import Reproduction


_LEAST_TURNED_RAD, _LEAST_APART_M = radians(0.1), 0.005
"""Least yaw and displacement of the truth's tracked point that are reported; mountings are rarely measured better."""
_PERHAPS = "perhaps"
"""Label of names below even odds."""
_HARDLY = 0.05
"""Confidence below which a part of the model is no finding: it is named beside the findings, if there are any."""
_TO_DECIDE, _DECIDES = "to decide, learn from a second drive as well", "a second drive decides"
_OF_ONE_DRIVE = ("time", "distance")
"""Regressors that no manoeuvre varies: another drive shows whether an error recurs."""


_EXACT = Line("exact", "0.1 mm of error per metre at most: a simulator's odometry, or a truth made of it", weight=FIRST)


_NAMED, _SET_UP, _NOT_IN_MODEL, _NOISE, _DOUBTFUL = range(5)
"""Groups of findings in their order; names below even odds are doubtful."""


def findings_brief(
    search: Learned,
    advice: Advice,
    comparison: Comparison,
    *,
    robot: RobotFit | None = None,
    written: MotionModel | None = None,
    notes: Sequence[str] = (),
    alerts: Sequence[str] = (),
    reproduction: Reproduction | None = None,
) -> Summary:
    """Return the findings of a search: each effect with size and probability, held-out errors, undecided alternatives.

    search, advice : the findings, and the alternatives that the data leave undecided
    comparison : the evaluated models; the first one lacks the findings
    robot : final fit of the robot, if it is not that of the search, with the noise that a localisation hides
    written : the model as written, which may lack findings that cannot be applied
    notes, alerts : the reader's notes on the recordings, and findings that are shown in any case
    reproduction : drift of the final model relative to the recordings, if known
    """
    exact = search.hardly_errs and not search.fit.effects  # without a model, not beside one
    fit, last = search.fit if robot is None else robot.fit, comparison.evaluations[-1]
    lines, negligible = _found_lines(search, fit, {name for choice in advice.choices for name in choice.names})
    verdict, tone = _verdict(search, comparison, lines)
    bursts = any(noise.effect.name == "slip_burst" for noise in search.noise)
    # errors and warnings follow the effects and dependences with evidence, and precede noise and clocks
    at = max(next((i for i, line in enumerate(lines) if line.label), len(lines)), 1)
    mounted = _mounting_words(search, fit)
    changes = [one.change for one in agreement_of(comparison).measures]
    falls = not comparison.evaluations[1:] or ("better" in changes and changes[0] != "worse")
    unexplained = is_unexplained(search, last, falls=falls)
    named = verdict != "COMPLETE" and bool(lines) and not unexplained
    if named:
        first = ": ".join(filter(None, (lines[0].label.replace(_PERHAPS, ""), lines[0].text)))
        if comparison.raw_error_m - comparison.clock_error_m > comparison.clock_error_m - last.ten_second_error_m:
            first = "; ".join([*_clock_words(search), first])  # most of the error is the clock's
        lines += [Line("set-up", mounted, weight=FIRST)] if mounted else []
    else:
        apart = ", and ".join([*_clock_words(search), *([mounted] if mounted else [])])
        none = "no relevant effect is missing" if negligible else "no known effect explains more than chance"
        first = f"the robot's model is complete; {apart}" if apart else none
    if unexplained:
        ratios = search.fit.problem.recordings[0].ratios or "a first look shows no plain mistake"
        verdict, tone, first = "UNKNOWN", "warning", f"nothing found explains the errors; {ratios}"
    elif reproduction is not None and reproduction.too_small and reproduction.by_outliers and not named:
        verdict, tone, first = "MISSING", "warning", "slip_burst or push: intervals that the fit left out as outliers"
    elif verdict == "COMPLETE" and last.verdict.fails and not exact:
        verdict, tone = "PROBABLY", "warning"
    lines = [Line(verdict, first, tone), *lines[named:]]
    lines[at:at] = [
        *_change_lines(search, fit, written),
        *(Line("data", alert, "warning", FIRST) for alert in alerts),
        *([_EXACT] if exact else _misfit_lines(reproduction, last, bursts=bursts)),
        *_written_lines(search, written),
        # the identity of an effect is more important than its gain
        *open_lines(search, advice),
        *untested_lines(search, advice, named=named),
        *drive_lines(search),
        *_error_lines(comparison),
    ]
    lines += [*hidden_noise(robot), *track_lines(search, failed=last.verdict.fails), *negligible]
    if reproduction is not None and reproduction_sentence(reproduction) and bursts:
        # noise that causes most of the error is more important than effects that cause less
        lines = [line._replace(weight=FIRST) if line.label == "noise" else line for line in lines]
    if notes := tuple(dict.fromkeys(notes)):
        said = notes[0] if len(notes) == 1 else f"{len(notes)} remarks: -v shows them"
        lines.append(Line("notes", said, "warning", SPARE))
    return Summary(tuple(lines))


def _change_lines(search: Learned, fit: Fit, written: MotionModel | None) -> list[Line]:
    """Return what to set in the robot's odometry, if sizes of wheels or their distance were found to be wrong."""
    sure = {one.effect.name for one in effects_found(search, fit) if not are_doubtful([one])}
    own = [] if written is None else [effect for effect in written.effects if effect.name in sure & WHEEL_EFFECTS]
    if written is None or not own:
        return []
    if any(effect.name == "unequal_wheels" for effect in own) and written.track_m is None:
        steers = "" if search.drive_type.stated else ", or its steering's zero (--drive-type car)"
        return [Line("change", f"wheel radii differ (--track){steers}", weight=FIRST)]
    separation, left, right = wheel_multipliers(replace(written, effects=tuple(own))).values()
    radius = 0.5 * (left + right)
    sizes = {"wheel_separation": separation, **({"wheel_radius": radius} if left == right else {})}
    verbs = {radius / separation: "turns"}
    verbs[radius] = "turns and travels" if radius in verbs else "travels"
    seen = [
        f"{verb} {100.0 * abs(ratio - 1.0):.2g} % {'more' if ratio > 1.0 else 'less'} than its odometry says"
        for ratio, verb in verbs.items()
        if ratio != 1.0
    ]
    if left != right:
        sizes |= {"left wheel's radius": left, "right one's": right}
        seen.append(f"bends to the {'left' if right > left else 'right'} where its odometry is straight")
    said, changed = " and ".join(seen), {name: ratio for name, ratio in sizes.items() if ratio != 1.0}
    long, short = (", ".join(f"{name} {to} {ratio:.4f}" for name, ratio in changed.items()) for to in ("to", "x"))
    return [Line("change", f"the robot {said}: set {long} of its value", weight=FIRST, short=f"{said}: {short}")]


def _error_lines(comparison: Comparison) -> list[Line]:
    """Return the errors without and with the findings by all measures; of one model with the clock, if that is off."""
    if len(comparison.evaluations) == 1:
        before, after = comparison.raw_error_m, comparison.clock_error_m
        said = f"10 s error {size('along', before)} -> {size('along', after)} with the clock corrected"
        return [Line("errors", said, weight=ALWAYS)] if before != after and isfinite(after) else []
    held, verdict = HELD[comparison.judged_on], agreement_of(comparison).verdict
    said = f"{measures_words(comparison)} ({held})"
    said += "; effects are chosen by likelihood" if verdict == "mixed" else ""
    return [Line("errors", said, TONES[verdict], ALWAYS, f"{measures_words(comparison, most=1)} ({held})")]


def _written_lines(search: Learned, written: MotionModel | None) -> list[Line]:
    """Return the effects of the fit that the written model lacks."""
    kept = {effect.name for effect in written.effects} if written is not None else set(search.added)
    absent = [e.name for e in search.fit.effects if e.kind != "setup" and e.name in set(search.added) - kept]
    said = f"without {' and '.join(absent)}, which cannot be applied as found (-v states why)"
    return [Line("model", said, "warning", FIRST)] if absent else []


def _misfit_lines(reproduction: Reproduction | None, last: ModelEvaluation, *, bursts: bool) -> list[Line]:
    """Return how far a simulation would drift, if far too little or too much, and by how much the model is rejected."""
    lines = []
    if reproduction is not None and not (reproduction.holds and bursts):
        label, said = "outliers" if reproduction.holds else "drift", reproduction_sentence(reproduction)
        lines += [Line(label, said, "warning", FIRST)] if said else []
    if last.verdict.fails:
        said = f"errors are {plainly(last.verdict.misfit)} times the predicted ones"
        said = f"the noise is too large: {said}" if last.verdict.misfit < 1.0 else said
        lines.append(Line("rejected", said, "warning", FIRST))
    return lines


def _verdict(search: Learned, comparison: Comparison, lines: Sequence[Line]) -> tuple[str, Tone]:
    """Return the first word of a summary and its tone.

    lines : the findings as of `_found_lines`
    """
    if not (search.lacking or search.noise or search.unexplained):
        return "COMPLETE", "good"
    if lines and (lines[0].label == _PERHAPS or lines[0].weight == SPARE):
        return _PERHAPS.upper(), "warning"
    if search.unexplained and not search.laws:
        # an effect was identified, but a dependence beside it remains unexplained
        return "UNKNOWN" if are_doubtful(effects_found(search)) else "PROBABLY", "warning"
    held, last = agreement_of(comparison).verdict, comparison.evaluations[-1].verdict
    if held == "worse" or (last.fails and last.misfit > GROSS):
        return "PROBABLY", "warning"
    return "MISSING", "warning" if held == "mixed" else "good"


def _clock_words(search: Learned) -> list[str]:
    """Return the findings about the clocks of the recordings."""
    said = []
    for one in {one.name: one for one in reversed([*clocks_found(search.clocks)])}.values():
        late, early = ("odometry", "truth") if one.value > 0.0 else ("truth", "odometry")
        offset = one.name == "time_offset"
        by = f"{float(f'{abs(one.value) * (1e3 if offset else 6e4):.2g}'):g} ms"
        runs = search.fit.problem.recordings
        where = f" in {runs[one.recording].name}" if len(runs) > 1 else ""
        apart = f"the two clocks run apart by {by} a minute"
        said.append((f"the {late} is stamped {by} later than the {early}" if offset else apart) + where)
    return said


def _largest(search: Learned) -> str:
    """Return the name of the effect by which odometry is displaced most in 10 s: the cause, also if of the set-up."""
    moved_m = {name: one.ten_seconds.moved_m for name, one in search.contributions.items()}
    return max(moved_m, key=moved_m.__getitem__, default="")


def _mounting_words(search: Learned, fit: Fit) -> str:
    """Return where the truth's tracked point sits on the robot and how it is turned, if significant; "" if not.

    A smaller set-up effect that the search selected has a line of its own.
    """
    said = []
    for effect, errors in effects_with_errors(fit):
        values = [getattr(effect, p.name) for p in amplitudes(effect)]
        if effect.name in search.added and effect.name != _largest(search):
            continue
        if effect.name == "mount_yaw" and abs(values[0]) > max(SIGNIFICANT * errors[0], _LEAST_TURNED_RAD):
            against = " against TF" if any(r.matched for r in fit.problem.recordings) else ""
            said.append(f"the truth is turned by {degrees(values[0]):.2g} deg{against}")
        elif effect.name == "lever_arm":
            sides = zip(values, errors, (("ahead of", "behind"), ("left of", "right of")), strict=True)
            where = [
                f"{f'{abs(v):.3g} m' if abs(v) >= 1.0 else f'{abs(v) * 1e2:.2g} cm'} {words[v < 0.0]}"
                for v, e, words in sides
                if abs(v) > max(SIGNIFICANT * e, _LEAST_APART_M)
            ]
            twins = readings_of(effect, search.drive_type)
            other = f" (lever_arm, or {' or '.join(twins)} of the robot)" if twins else " (lever_arm)"
            said.append(f"the truth follows a point {' and '.join(where)} the base{other}" if where else "")
    return ", and ".join(filter(None, said))


def _found_lines(search: Learned, fit: Fit, undecided: set[str]) -> tuple[list[Line], list[Line]]:
    """Return a line for each effect, dependence, noise and clock found; and a line of negligible ones.

    Effects and dependences of the model come first, in order of their evidence; then dependences that are not in the
    model, noise, names below even odds, and the set-up. Negligible findings share one line, because they require no
    action, and so do parts of the model that are hardly causes, if anything else was found.

    undecided : names in the line of undecided alternatives
    """
    ranked: list[tuple[tuple[int, float], Line]] = []  # in a group the one with the most evidence is first
    ranks: dict[str, tuple[int, float]] = {}
    small: dict[str, str] = {}  # texts of negligible parts by name
    absent: list[str] = []  # negligible and not in the model
    effects = effects_found(search, fit)
    sure = not are_doubtful(effects)
    hardly = {one.effect.name for one in effects if one.confidence < _HARDLY}
    for one in effects:
        name, said = one.effect.name, f"{one.names}  {', '.join(one.numbers)}"
        if one.negligible:
            small[name] = said
            continue
        rivals = [rival for rival in one.rivals if rival not in undecided]
        said += f"  {one.probability}"
        said += f", or {', '.join(rivals)}" if rivals else ""
        doubtful = one.confidence < EVEN_ODDS
        group, label = (_DOUBTFUL, _PERHAPS) if doubtful else (_NAMED, "")
        if name in search.of_setup and name != _largest(search):
            group, label = _SET_UP, "set-up"
        ranks[name] = (group, -one.nats)
        # without any likelier effect it is what the errors fall by
        weight = FOUND if not doubtful else SPARE if sure else USUAL
        ranked.append((ranks[name], Line(label, said, weight=weight, part="" if group == _SET_UP else _part(one))))
    for unknown in foremost(dependences_found(search, fit), 2):
        law = unknown.law
        if law in search.unexplained or law.instead_of:
            named, remark = alternative(law, hardly), _left_out(unknown)
            said = f"{named}: {unknown.expression}{remark}"
            short = "" if unknown.fitted else f"{named}{f': {_DECIDES}' if _TO_DECIDE in remark else remark}"
            beside = [ranks[name] for name in law.instead_of if name in ranks]
            own = (_NAMED if unknown.fitted else _NOT_IN_MODEL, -law.nats)
            rank = max(beside, default=own)
            weight = FOUND if unknown.fitted else USUAL if rank[0] <= _NOT_IN_MODEL else SPARE
            ranked.append((rank, Line("", said, weight=weight, short=short, part=unknown.part)))
        elif unknown.fitted:
            small[unknown.part] = unknown.expression
        else:
            absent.append(unknown.expression)
    for noise in noise_found(search):
        said = f"{noise.names}, {', '.join(noise.numbers)}  {noise.probability}"
        doubtful = noise.confidence < EVEN_ODDS
        group = _DOUBTFUL if doubtful else _NOISE
        ranked.append(((group, 0.0), Line("noise", said, weight=SPARE if doubtful else USUAL, part=_part(noise))))
    likely = [one for one in effects if not (one.negligible or one.effect.name in search.of_setup)]
    lines = _beside_findings(ranked, [*likely, *noise_found(search)])
    lines += _clock_lines(search.clocks, search.fit)
    lines += [
        Line(
            "disagree",
            f"recordings disagree about {one.effect} (p {one.p:.2g}): {groups_words(one) or 'did the robot change?'}",
            "warning",
        )
        for one in search.disagreements
    ]
    lines += [Line("data", contradiction(one), "warning") for one in search.contradicted]
    trivial = [f"{', '.join(small.values())}: in the model, but negligible"] if small else []
    trivial += [f"{', '.join(absent)}: negligible, and not in the model"] if absent else []
    return lines, [Line("negligible", "; ".join(trivial), weight=SPARE, part=", ".join(small))] if trivial else []


def _beside_findings(ranked: Sequence[tuple[tuple[int, float], Line]], parts: Sequence[Found]) -> list[Line]:
    """Return lines in order, with one line for all parts that are hardly causes if there are other findings."""
    hardly = [_part(one) for one in parts if one.confidence < _HARDLY]
    ordered = sorted(ranked, key=lambda one: one[0])
    findings = [(rank, line) for rank, line in ordered if line.part not in hardly]
    if not hardly or all(group == _SET_UP for (group, _), _ in findings):
        return [line for _, line in ordered]
    named = ", ".join(hardly)
    return [*(line for _, line in findings), Line("included", f"also {named}", weight=SPARE, part=named)]


def _part(one: Found) -> str:
    """Return the name of a part of the model, after "perhaps" below even odds, or with its confidence."""
    name = one.effect.name
    if one.confidence < _HARDLY:
        return f"{name} ({confidence_words(one.confidence)})"
    return name if one.confidence >= EVEN_ODDS else f"{_PERHAPS} {name}"


def _left_out(unknown: FoundDependence) -> str:
    """Return that a dependence is reported only, not in the model, and what decides; "" if nothing is to be said."""
    law = unknown.law
    if unknown.fitted:
        return ""
    other = _TO_DECIDE if law.regressor in _OF_ONE_DRIVE else ""
    if law.instead_of:
        return f" ({other})" if other else ""
    if unknown.left_out:
        return f" (left out of the model: {unknown.left_out})"
    return f" ({'; '.join(filter(None, ('not in the model', other)))})"


def _clock_lines(clocks: Clocks, fit: Fit) -> list[Line]:
    # parts of one run share a clock, which needs one line
    runs = fit.problem.recordings
    names = [run.clock.rpartition(" from ")[0] or run.name for run in runs]
    first = [[one.clock or one.name for one in runs].index(run.clock or run.name) for run in runs]
    found = [one for one in clocks_found(clocks) if first[one.recording] == one.recording]
    return [Line("clock", f"{one.name} {clock_text(one)} in {names[one.recording]}") for one in found]


def fit_brief(result: RobotFit) -> Summary:
    """Return the error after 10 s on the fitted data, the noise coefficients and the effects of a fit."""
    fit = result.fit
    law = fit.problem.approach.law_name
    names = ", ".join(r.name for r in fit.problem.recordings)
    error = size("along", result.ten_second_error_m)
    lines = [Line("FITTED", f"{names}: 10 s error {error} on the fitted data", "good")]
    k = fit.noise.coefficients
    numbers = [f"{i.name} {getattr(k, i.name):.3g}" for i in result.intervals if i.identifiable]
    lines.append(Line("noise", f"law {law}: {', '.join(numbers) or 'nothing identifiable'}"))
    lines += hidden_noise(result)
    hidden = [i.name for i in result.intervals if not i.identifiable]
    if hidden:
        lines.append(Line("", f"not identifiable from this drive: {', '.join(hidden)}", "warning"))
    for effect, errors in effects_with_errors(fit):
        kind = "set-up" if effect.kind == "setup" else "effect"
        lines.append(Line(kind, f"{effect.name}  {', '.join(numbers_text(effect, errors))}"))
    return Summary((*lines, *_clock_lines(result.clocks, fit)))


_LIKE_SINGLE_WHEELS = ("lever_arm", "icr_shift", "time_offset")
"""Effects that resemble errors of single wheels: a larger wheel shifts turns as the y of a lever arm does."""
_PER_METRE = {"rot_trans": "of heading", "trans_trans": "along", "across_trans": "across"}


def mistakes_first(brief: Summary, mistakes: Sequence[Mistake]) -> Summary:
    """Return a summary that begins with plain mistakes: what is seen, usual causes, and what to change."""
    lines: list[Line] = []
    for one in mistakes:
        lines += [Line("MISTAKE", one.said, "bad", ALWAYS), Line("causes", one.causes, weight=FIRST)]
        lines.append(Line("change", "; ".join(filter(None, (one.change, one.then))), "warning", ALWAYS))
    rest = [one._replace(label="otherwise") if lines and one.label == "COMPLETE" else one
            for one in brief.lines if not (lines and one.label == "change")]  # fmt: skip
    return Summary((*lines, *rest), brief.most + len(lines))


def drive_lines(search: Learned) -> list[Line]:
    """Return the drive type, if names depend on an inferred one, or on the default of a robot that may be steered."""
    drive = search.drive_type
    if drive.reason:
        return [Line("drive type", f"{drive.sentence}; --drive-type overrules it")]
    of_wheels = {kind.unsteered for kind in registry().values()} & set(search.added)
    if not (drive.least_radius_m and of_wheels):
        return []
    said = f"it never turned on the spot (smallest radius {drive.least_radius_m:.2g} m): if it steers, --drive-type car"
    return [Line("drive type", said, "warning")]


def track_lines(search: Learned, *, failed: bool) -> list[Line]:
    """Return the approximations due to an unknown track, if a finding may depend on them."""
    recordings = search.fit.problem.recordings
    if search.drive_type.name != "differential" or any(r.track_m is not None for r in recordings):
        return []
    if not (search.added or search.unknown or failed or any(clocks_found(search.clocks))):
        return []
    fitted = [e.name for e in search.fit.effects if getattr(e, "track", 0.0)]
    ghosts = [name for name in search.added if name in _LIKE_SINGLE_WHEELS]
    said = f"that of {', '.join(fitted)} was fitted" if fitted else "errors of single wheels are approximated"
    said += f", {', '.join(ghosts)} may come from them" if ghosts else ""
    return [Line("track", f"not given: {said}; measure it (--track)", "warning")]


def open_lines(search: Learned, advice: Advice) -> list[Line]:
    """Return the alternatives that the data cannot separate and the drive to do so, if there are any that matter."""
    matters = tuple(choice for choice in advice.choices if not search.is_negligible(choice.names[0]))
    said = inseparable_sentence(replace(advice, choices=matters), lambda name: readings_of(name, search.drive_type))
    return [Line("open", said, "warning", SPARE)] if said else []


def untested_lines(search: Learned, advice: Advice, *, named: bool) -> list[Line]:
    """Return the effects hidden by the scale error of a gyro or laser that serves as truth, with the remedy.

    named : whether there are findings; else the frequent causes that the drives could not show are returned, too
    """
    hidden = [one for one in advice.untestable if one.limited_by_truth]
    said = [f"{one.effect}: {one.why}; {one.hint}" for one in hidden]
    names = [one.effect for one in advice.untestable if one.effect in search.decisions.common and one not in hidden]
    if names and not named:
        said.append(f"{', '.join(names)}: not visible in these data (-v: why, and what would show it)")
    return [Line("not testable", one, "warning") for one in said]


def hidden_noise(result: RobotFit | None) -> list[Line]:
    """Return a line on noise for which a localisation gives only an upper bound."""
    hidden = [] if result is None else [i for i in result.noise_at_most if i.name in _PER_METRE]
    if not hidden:
        return []
    bounds = [f"{degrees(i.high):.2g} deg" if i.name == "rot_trans" else f"{i.high * 1e3:.2g} mm" for i in hidden]
    most = ", ".join(f"{bound} {_PER_METRE[i.name]}" for bound, i in zip(bounds, hidden, strict=True))
    return [
        Line(
            "noise",
            f"at most {most} after a metre (95 %): the localisation's own errors mask it; the model has the estimate",
        )
    ]
