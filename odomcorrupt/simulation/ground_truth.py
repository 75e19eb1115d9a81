"""The answer to a hidden cause: a file of its own, whose fingerprint alone goes into the bag."""

from collections.abc import Mapping
from hashlib import sha256

from odomcorrupt.simulation.fault_draws import EVERY
from odomcorrupt.simulation.library_faults import CAUSES
from odomcorrupt.simulation.record import SimulatedRun
from odomcorrupt.simulation.streams import stream


def format_answer(run: SimulatedRun, seed: int, made: Mapping[str, str | float]) -> str:
    """Return the answer as TOML.

    A salt makes sure that nobody finds the answer by hashing guesses.

    Parameters
    ----------
    seed : int
        Seed of the run, which tells all.
    made : mapping
        How else the run was made.
    """
    lines = ["schema = 1", f"seed = {seed}", f'salt = "{stream(seed, "salt").bytes(16).hex()}"']
    lines += [f"{name} = {_toml(value)}" for name, value in made.items()]
    lines += [f"track_m = {run.track_m!r}"]
    if not run.answer["causes"]:
        lines += ["causes = []"]
    for name, parameters in run.answer["causes"].items():
        lines += ["", "[[causes]]", f'name = "{name}"', f"in_library = {str(name in CAUSES).lower()}"]
        if name not in CAUSES:
            lines += [f'depends_on = "{EVERY[name].depends_on}"']
        lines += ["[causes.parameters]", *(f"{key} = {_toml(value)}" for key, value in parameters.items())]
    return "\n".join(lines) + "\n"


def fingerprint(answer: str) -> str:
    """Return the SHA-256 of an answer file's text, in hexadecimal."""
    return sha256(answer.encode()).hexdigest()


def _toml(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)
