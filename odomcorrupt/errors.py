"""What can go wrong, as types. Every message says what: the value found; the way out."""


class OdomCorruptError(Exception):
    """Root of all errors that a user can cause or cure; the command line exits with 1."""


class BagError(OdomCorruptError, OSError):
    """A bag cannot be read or written."""

    def __str__(self) -> str:
        """Return the sentence alone: OSError would add an errno that we do not have."""
        return str(self.args[0]) if self.args else ""


class TopicError(OdomCorruptError):
    """A topic or frame is missing, ambiguous or of a type that cannot be used."""


class MapError(OdomCorruptError):
    """A map cannot be read, or does not say what is asked of it."""


class ModelError(OdomCorruptError, ValueError):
    """A model file, a law or its coefficients make no sense."""


class EffectError(ModelError):
    """An effect is unknown, badly parametrised or too strong to be inverted."""


class RecordingError(OdomCorruptError):
    """A recording of odometry and truth cannot be used."""


class FitError(OdomCorruptError):
    """A recording does not carry what a fit needs."""
