"""The exceptions. All are ``ValueError``; each text says what came, what was wanted, and what to change."""

__all__ = [
    "AnswerError", "DeviceError", "DirectionError", "EagorError", "FormatError", "GridError", "ImageError",
    "MissingExtraError", "PoseError", "QueryError", "ResponseError", "RotationError", "ServerError", "StorageError",
    "TimeError", "WorkError", "WorldError",
]  # fmt: skip


class EagorError(ValueError):
    """Base of the errors that this package raises for bad input."""


class DeviceError(EagorError):
    """A camera, a robot or a network interface is not there, or does not give what was asked for."""


class DirectionError(EagorError):
    """A direction has the wrong shape, is not finite, or is the zero vector."""


class RotationError(EagorError):
    """A matrix or quaternion is not a rotation (wrong shape, not orthogonal, a reflection, not finite)."""


class GridError(EagorError):
    """A grid cannot exist (size zero, impossible field of view) or does not fit its values."""


class ResponseError(EagorError):
    """A response, score, box or mask is empty, not finite or outside its range."""


class TimeError(EagorError):
    """A time stamp is missing, not finite, or too early."""


class PoseError(EagorError):
    """A pose is missing, incomplete, or older than the history."""


class QueryError(EagorError):
    """The perception does not know the words of the query."""


class ImageError(EagorError):
    """An image file is missing, corrupt, or has an unusable shape."""


class FormatError(EagorError):
    """A text file (CSV, JSONL) does not follow its documented format."""


class WorldError(EagorError):
    """A simulated world cannot be built, read or walked in as asked."""


class AnswerError(EagorError):
    """A model's answer cannot be read."""


class ServerError(EagorError):
    """A model's server cannot be reached, or refuses the request."""


class StorageError(EagorError):
    """A file cannot be written; what was written before is intact."""


class MissingExtraError(EagorError, ImportError):
    """A package that one of our extras brings, or a model, is not installed; the text says how to install it."""


class WorkError(EagorError):
    """The work of a run cannot start: it cannot be imported, or its settings are wrong."""
