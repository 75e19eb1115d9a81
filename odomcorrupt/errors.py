"""Exception types. Every message says what failed, the value found, and the way out."""


class OdomCorruptError(Exception):
    """Base class of all errors that a user can cause or fix; the command line exits with 1."""


class BagError(OdomCorruptError, OSError):
    """A bag cannot be read or written."""

    def __str__(self) -> str:
        """Return the message alone, without the errno of an OSError."""
        return str(self.args[0]) if self.args else ""


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
