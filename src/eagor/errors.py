"""What can be wrong with an input, one name each.

Every error is a ``ValueError``, so callers that do not care about the kind can catch that. The text of
an error always says three things: what came, what was wanted, and what to change.
"""

__all__ = [
    "AnswerError", "DirectionError", "EagorError", "FormatError", "GridError", "ImageError", "PoseError", "QueryError",
    "ResponseError", "RotationError", "ServerError", "StorageError", "TimeError", "WorkError", "WorldError",
]  # fmt: skip


class EagorError(ValueError):
    """Base of the errors that this package raises for bad input."""


class DirectionError(EagorError):
    """A direction has the wrong shape, is not finite, or is the zero vector."""


class RotationError(EagorError):
    """A matrix or quaternion is not a rotation (wrong shape, not orthogonal, a reflection, not finite)."""


class GridError(EagorError):
    """A grid cannot exist (size zero, impossible field of view) or does not fit its values."""


class ResponseError(EagorError):
    """A response, score, box or mask is empty, not finite or outside its range."""


class TimeError(EagorError):
    """A time stamp is missing, not finite, or runs backwards."""


class PoseError(EagorError):
    """A pose is missing, incomplete, or too old to be known any more."""


class QueryError(EagorError):
    """The words asked for mean nothing to the perception that was asked."""


class ImageError(EagorError):
    """An image file is missing, corrupt, or has an unusable shape."""


class FormatError(EagorError):
    """A text file (CSV, JSONL) does not follow its documented format."""


class WorldError(EagorError):
    """A simulated world cannot be built, read or walked in as asked."""


class AnswerError(EagorError):
    """What a model answered cannot be read."""


class ServerError(EagorError):
    """A server that a model runs on cannot be reached, or refuses what is asked of it."""


class StorageError(EagorError):
    """The disk does not take what has to be kept; what was kept before is whole."""


class MissingExtraError(EagorError, ImportError):
    """A package is not installed that one of our extras brings; the text says how to install it."""


class WorkError(EagorError):
    """The work of a run cannot be begun: it cannot be imported, or cannot be set up from its settings."""
