"""Add realistic, repeatable drift to the odometry in ROS bags and MCAP; find out what makes your robot drift.

The Python interface; each name is imported on first use, so that `import odomcorrupt` is fast.

>>> import odomcorrupt as oc
>>> oc.Model.preset("typical").parameters["rot_trans"]
0.02
"""

TYPE_CHECKING = False
"""As in `typing`, whose import would double the time until Ctrl-C is handled quietly (`__main__`).

Nothing is imported here: under `python -m` the working directory is on Python's path until `__main__` runs.
"""

if TYPE_CHECKING:
    from typing import Any

    from odomcorrupt.api.batch import Assembly, Batch, BatchCost, Spread, assemble, batch, estimate_batch, spread
    from odomcorrupt.api.catalogue import (
        EffectDescription,
        EffectList,
        PresetList,
        describe_effect,
        list_effects,
        list_presets,
    )
    from odomcorrupt.api.corruption import Correction, Corruption, Drift, Drifted, correct, corrupt
    from odomcorrupt.api.findings import (
        Comparison,
        Diagnosis,
        Fit,
        Learned,
        SquareTest,
        compare,
        diagnose,
        fit,
        fit_returns,
        learn,
    )
    from odomcorrupt.api.integration import Integration, integrate
    from odomcorrupt.api.maps import Maps, draw_maps
    from odomcorrupt.api.model import Conversion, Export, Model, Noise, convert_alpha, export_parameters
    from odomcorrupt.api.motion import Density, Particles, Samples, density, sample, sample_along
    from odomcorrupt.api.preview import Info, Preview, info, preview
    from odomcorrupt.api.recordings import Recordings, read_recordings
    from odomcorrupt.api.score import Score, score
    from odomcorrupt.api.simulation import Simulation, simulate
    from odomcorrupt.errors import OdomCorruptError
    from odomcorrupt.scoring.errors import path_errors
    from odomcorrupt.scoring.run import Estimate, read_estimate

__version__ = "0.1.0"

_HOMES = {
    "api.batch": "Assembly Batch BatchCost Spread assemble batch estimate_batch spread",
    "api.catalogue": "EffectDescription EffectList PresetList describe_effect list_effects list_presets",
    "api.corruption": "Correction Corruption Drift Drifted correct corrupt",
    "api.findings": "Comparison Diagnosis Fit Learned SquareTest compare diagnose fit fit_returns learn",
    "api.integration": "Integration integrate",
    "api.maps": "Maps draw_maps",
    "api.model": "Conversion Export Model Noise convert_alpha export_parameters",
    "api.motion": "Density Particles Samples density sample sample_along",
    "api.preview": "Info Preview info preview",
    "api.recordings": "Recordings read_recordings",
    "api.score": "Score score",
    "api.simulation": "Simulation simulate",
    "errors": "OdomCorruptError",
    "scoring.errors": "path_errors",
    "scoring.run": "Estimate read_estimate",
}
"""Modules of the public names."""
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = [
    "Assembly", "Batch", "BatchCost", "Comparison", "Conversion", "Correction", "Corruption", "Density", "Diagnosis",
    "Drift", "Drifted", "EffectDescription", "EffectList", "Estimate", "Export", "Fit", "Info", "Integration",
    "Learned", "Maps", "Model", "Noise", "OdomCorruptError", "Particles", "PresetList", "Preview", "Recordings",
    "Samples", "Score", "Simulation", "Spread", "SquareTest", "__version__", "assemble", "batch", "compare",
    "convert_alpha", "correct", "corrupt", "density", "describe_effect", "diagnose", "draw_maps", "estimate_batch",
    "export_parameters", "fit", "fit_returns", "info", "integrate", "learn", "list_effects", "list_presets",
    "path_errors", "preview", "read_estimate", "read_recordings", "sample", "sample_along", "score", "simulate",
    "spread",
]  # fmt: skip


def __getattr__(name: str) -> "Any":
    """Import the module of a public name."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    try:
        globals()[name] = value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    except ImportError as error:
        from odomcorrupt.extras import explained

        raise explained(error) from error
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
