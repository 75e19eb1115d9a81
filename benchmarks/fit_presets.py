"""The numbers of the presets that were fitted from real robots, made again.

    python benchmarks/fit_presets.py ../shared/data/real

Each preset is what `odomcorrupt fit` says of all runs of one robot, law diffusion, rounded to two digits: its noise
about its own best straight fit of clocks, with no effect added, so what is systematic in the robot is not in it. Needs
the study extra; the files are named in `ROBOTS`. Prints each fit beside the preset that is built in.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from odomcorrupt.model.presets import PRESETS
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.io import Source, read_runs

ROBOTS = {
    "optitrack-diff-drive": "optiodom_diff_*.mcap",
    "optitrack-tricycle": "optiodom_tricyc_*.mcap",
    "mrclam-create": "mrclam6_*.mcap",
}


def main() -> None:
    """Print the fitted coefficients of every robot, as `presets.py` has them."""
    folder = Path(sys.argv[1])
    for name, pattern in ROBOTS.items():
        files = sorted(folder.glob(pattern))
        if not files:
            print(f"{name}: no {pattern} in {folder}")
            continue
        runs = [run for file in files for run in read_runs(Source(file))]
        found = fit_robot(runs, [], law_name="diffusion").model.noise.coefficients
        built_in = PRESETS[name].noise.coefficients
        print(f"{name} ({len(files)} runs)")
        for field in dataclasses.fields(found):
            value = getattr(found, field.name)
            if value:
                print(f"  {field.name:12} {float(f'{value:.2g}'):<8g} built in: {getattr(built_in, field.name):g}")


if __name__ == "__main__":
    main()
