"""odomcorrupt map: laser maps from clean and from noisy odometry."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._model import AlphaCommand, choose_model, model_options
from odomcorrupt.commands._options import FILE, PAGE, PICTURE, POSE, Number, one_of, save_picture
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.result_files import refuse_existing, write_bytes, write_text
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.mapping.scan_map import ScanMap


@click.command("map", cls=AlphaCommand, short_help="Draw laser maps with clean and with noisy odometry.")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=FILE, help="Picture: .png, .svg or .pdf; the maps are written beside it as .pgm and .yaml."
)
@model_options
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Seed of all draws. [default: drawn, and printed]")
@click.option(
    "--run", type=click.IntRange(0), default=0, metavar="N", help="Number of the run under this seed. [default: 0]"
)
@click.option("--scan", metavar="TOPIC", help="Laser scans. [default: the only such topic]")
@click.option(*ODOM_TOPIC, metavar="TOPIC", help="Odometry that places the scans.")
@click.option("--truth", metavar="TOPIC", help="Draw the map through these poses as well.")
@click.option("--laser-pose", type=POSE, help="Pose of the laser on the robot, if TF does not contain it.")
@click.option(
    "--max-yaw-rate", type=Number("rad/s", 0.0, 1e3), metavar="W",
    help="Leave out rays shot while turning faster, rad/s.",
)  # fmt: skip
@click.option(
    "--resolution", type=Number("metres", 0.0, 1e3, above=True), default=0.05,
    help="Cell size of the maps, metres. [default: 0.05]",
)  # fmt: skip
@one_of(
    "--method", among=["odometry", "laser"],
    text="Place scans by odometry, or by matching them: then -o map.yaml also gets map.tum and map.png.",
)  # fmt: skip
@overwrite_option("existing outputs", passed=True)
@unpack_option
@standard_options
def command(bag: Path, output: Path | None, *, console: Console, **given: Any) -> None:
    """Draw the map a laser makes through a bag's odometry, and through the same odometry with noise on it.

    Reports the wall thickness of both, and its growth along the drive.

    \b
    odomcorrupt map drive.mcap -o map.png
    odomcorrupt map drive.mcap --alpha 0.1 0.05 0.05 0.01 --seed 3 -o map.png
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.corruption.summary import model_brief
    from odomcorrupt.mapping.scan_map import maps_brief, maps_json, maps_table
    from odomcorrupt.rng import draw_seed

    if str(bag) == "-":
        raise OdomCorruptError("-: a map is made from the whole drive, which is impossible on a pipe; name a file")
    if given["method"] == "laser":
        _by_laser(bag, output, given, console)
        return
    beside = {} if output is None else {name: output.with_name(f"{output.stem}_{name}") for name in ("clean", "noisy")}
    if output is not None:
        PICTURE.require_writable(output, overwrite=given["overwrite"])
    for path in (p.with_suffix(end) for p in beside.values() for end in (".pgm", ".yaml")):
        refuse_existing(path, overwrite=given["overwrite"])
    chosen = choose_model(given)
    seed = draw_seed() if given["seed"] is None else given["seed"]
    with Stages("drawing maps", quiet=console.quiet):
        notes, maps = _scan_maps(bag, chosen.motion_model, seed, given)
    origin = f" ({chosen.origin})" if chosen.origin else ""
    noise = f"noise: {chosen.motion_model.noise.words}{origin}, seed {seed}, run {given['run']}"
    text = "\n".join([noise, *notes, maps_table(maps)])
    model = model_brief(chosen.motion_model, chosen.origin.partition(":")[0])
    following = ["odomcorrupt", "map", *typed_words("--output", "--overwrite"), "-o", "map.png"]
    if output is not None:
        following = ["odomcorrupt", "preview", str(bag)]
    brief = maps_brief(maps, notes, (model, f"{seed}, run {given['run']}"), following)
    files: dict[Path, Callable[[], object]] = {}
    if output is not None:
        for scan_map, path in zip(maps, beside.values(), strict=False):
            files[path.with_suffix(".yaml")] = partial(_write_map, scan_map, path)
        files[output] = partial(_draw, output, maps, "added by noise")
    console.print(brief, text, maps_json(maps, notes, seed), files=files)


def _write_map(scan_map: ScanMap, path: Path) -> None:
    """Write a map as image and YAML, whatever the suffix of the path."""
    from odomcorrupt.mapping.occupancy_grid import format_map

    image, text = format_map(scan_map.grid, path.with_suffix(".pgm").name)
    write_bytes(path.with_suffix(".pgm"), image)
    write_text(path.with_suffix(".yaml"), text)


def _draw(path: Path, maps: Sequence[ScanMap], added: str) -> None:
    from odomcorrupt.mapping.scan_map import WINDOW_M
    from odomcorrupt.report.plots.maps import draw_scan_maps

    save_picture(path, draw_scan_maps(maps, WINDOW_M, added))


def _by_laser(bag: Path, output: Path | None, given: dict[str, Any], console: Console) -> None:
    """Write the map made by scan matching with its trajectory, and the picture of the maps side by side."""
    from odomcorrupt.corruption.path import NoisyPath
    from odomcorrupt.laser.mapping import largest_part, laser_maps, tum_text
    from odomcorrupt.mapping.scan_map import maps_json
    from odomcorrupt.rng import draw_seed
    from odomcorrupt.study.io.laser_truth import laser_run

    if given["truth"] is not None or given["laser_pose"] is not None:
        raise click.UsageError("--method laser finds where the laser sits and takes no --truth; leave them out")
    files = {} if output is None else {end: output.with_suffix(end) for end in (".yaml", ".pgm", ".tum", ".png")}
    if output is not None:
        if output.suffix != ".yaml":
            raise click.UsageError(f"{output}: --method laser writes a map for nav2; name it .yaml")
        for path in files.values():
            PAGE.require_writable(path, overwrite=given["overwrite"])
    chosen = choose_model(given)
    seed = draw_seed() if given["seed"] is None else given["seed"]
    with Stages(quiet=console.quiet) as stages:
        run, parts = largest_part(laser_run(bag, str(bag), given["odom_topic"], given["scan"], stages))
    odometry = run.odometry
    noise = NoisyPath(chosen.motion_model, seed, given["run"]).feed(odometry.stamps_ns, odometry.xyt)
    drawn = laser_maps(run, noise.error_xyt, given["resolution"])
    placed = f"{len(run.path)} of {len(run.sweeps)} sweeps placed in the map"
    remarks = [*run.sweeps.notes, *run.calibration.said]
    notes = [*remarks, *([parts] if parts else []), placed]
    thick = ", ".join(f"{100.0 * s.thickness_m[-1]:.2f} cm {s.name}" for s in drawn.maps)
    said = "\n".join([*notes, f"wall thickness (root of the mean plane variance, Razlaw et al., ECMR 2015): {thick}"])
    lines = [Line("MATCHED", placed, "good")]
    lines += [Line("parts", parts, "warning")] if parts else []
    lines += [Line("walls" if not i else "", f"{100.0 * s.thickness_m[-1]:.2f} cm thick, {s.name}") for i, s in
              enumerate(drawn.maps)]  # fmt: skip
    lines += [Line("note", note, "warning") for note in remarks]
    following = ["odomcorrupt", "map", bag, "--method", "laser", "-o", "map.yaml"]
    following = following if output is None else ["odomcorrupt", "learn", bag, "--truth-file", files[".tum"]]
    writers: dict[str, Callable[[], object]] = {
        ".yaml": lambda: _write_map(drawn.maps[0], files[".yaml"]),
        ".tum": lambda: write_text(files[".tum"], tum_text(drawn.trajectory)),
        ".png": lambda: _draw(files[".png"], drawn.maps, "added by the odometry"),
    }
    named = {files[end]: write for end, write in writers.items()} if files else {}
    console.print(Summary((*lines, command_line(following))), said, maps_json(drawn.maps, notes, seed), files=named)


def _scan_maps(bag: Path, model: Any, seed: int, given: dict[str, Any]) -> tuple[tuple[str, ...], list[ScanMap]]:
    import numpy as np

    from odomcorrupt.corruption.path import NoisyPath
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.mapping.frames import mount_at
    from odomcorrupt.mapping.occupancy_grid import canvas_for
    from odomcorrupt.mapping.scan_map import make_scan_map, place, read_rays, slow_rays
    from odomcorrupt.trajectories import read_drive, read_poses

    drive = read_drive(bag, given["odom_topic"])
    mount = None if given["laser_pose"] is None else mount_at(np.array(given["laser_pose"]))
    rays = read_rays(bag, given["scan"], drive.child_frame_id, mount)
    slow = slow_rays(rays, drive, given["max_yaw_rate"])
    samples = NoisyPath(model, seed, given["run"]).feed(drive.stamps_ns, drive.xyt)
    paths = {
        "clean odometry": drive.trajectory,
        "noisy odometry": Trajectory(drive.stamps_ns, drive.xyt + samples.error_xyt),
    }
    if given["truth"] is not None:
        paths[f"truth ({given['truth']})"] = read_poses(bag, given["truth"])
    views = {name: place(slow.rays, path) for name, path in paths.items()}
    every = [part for view in views.values() for part in (view.from_xy, view.to_xy)]
    canvas = canvas_for(np.concatenate(every), given["resolution"])
    notes = (*drive.notes, f"{len(slow.rays)} rays of {rays.scans} scans from {rays.frame_id}", *slow.notes)
    clean = views["clean odometry"]
    return notes, [make_scan_map(n, paths[n].xyt, view, clean, slow.travelled_m, canvas) for n, view in views.items()]
