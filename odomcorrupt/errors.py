"""Exception types. Every message says what failed, the value found, and the way out."""

import re

COMMAND_LINE_ONLY = frozenset(("--clock", "--help", "--rate", "--returns", "--save", "--speed", "--turn-rate"))
"""Options in messages that no argument in Python corresponds to."""
_ARGUMENTS = {
    "--add": "effects", "--effect": "effects", "--end": "ends", "--exclude-topic": "exclude", "--input": "original",
    "--map": "within", "--overwrite": "overwrite=True", "--recover": "recover=True", "--robot-radius": "radius_m",
    "--start": "start_xyt", "--sweep": "sweeps", "--to-step": "step", "--wheel-radius": "wheel_radius_m",
    "--truth-shift": "truth_shift_s", "--max-unpacked ": "ODOMCORRUPT_MAX_UNPACKED=", "--track": "track_m",
    "with --tf odometry": "without new_odom_frame", "--tf correction": "new_odom_frame", "--wheelbase": "wheelbase_m",
    **{word: word for word in COMMAND_LINE_ONLY},
}  # fmt: skip
"""Arguments in Python that are not called like the option."""
_OPTION = re.compile(
    r"(?<![\w/.-])(?:with --tf odometry|--tf correction|--max-unpacked |--[a-z][a-z-]*[a-z](?![\w./-]))"
)


class OdomCorruptError(Exception):
    """Base class of all errors that a user can cause or fix; the command line exits with 1.

    Messages are written with options of the command line, as in `--odom-topic`; `str` replaces each by the argument in
    Python, as in `odom_topic`, except while the command line runs.
    """

    names_options = False
    """Whether `str` keeps the options, in all errors: set by the command line."""

    @property
    def message(self) -> str:
        """The message with options of the command line; without the errno of an OSError."""
        return str(self.args[0]) if self.args else ""

    def __str__(self) -> str:
        if OdomCorruptError.names_options:
            return self.message
        return _OPTION.sub(lambda one: _ARGUMENTS.get(one[0], one[0][2:].replace("-", "_")), self.message)


class BagError(OdomCorruptError, OSError):
    """A bag cannot be read or written."""


class TopicError(OdomCorruptError):
    """A topic or frame is missing, ambiguous or of a type that cannot be used."""


class MapError(OdomCorruptError):
    """A map cannot be read, or lacks what is needed."""


class ModelError(OdomCorruptError, ValueError):
    """A model file, a noise law or its coefficients are invalid."""


class EffectError(ModelError):
    """An effect is unknown, badly parametrised or too strong to be inverted."""


class RecordingError(OdomCorruptError):
    """A recording of odometry and truth cannot be used."""


class FitError(OdomCorruptError):
    """A recording does not contain the data that a fit needs."""


class BatchError(OdomCorruptError):
    """A batch cannot be started, continued or read."""


class BatchOptionError(BatchError):
    """Options of a batch contradict each other."""
