"""What can go wrong with data, by meaning.

Misuse of the library (a wrong type, a wrong shape) raises `TypeError` or `ValueError`. Data that cannot
give an answer raises a subclass of `SemscapeError`, whose message names the file or view, the figure and
the way out. The command line turns `BadInputError` into exit code 2 and every other one into 3.
"""

from __future__ import annotations

import sys


class SemscapeError(Exception):
    """Base of every error that semscape raises about data."""


class BadInputError(SemscapeError):
    """Files, folders or settings that cannot be used as given (exit code 2)."""


class PassingError(SemscapeError):
    """What the same data and options may well survive another time: it says nothing about them."""


class StorageError(BadInputError, PassingError):
    """Files or folders that cannot be read or written now: in use, full, protected, changing (exit code 2)."""


class OutOfMemoryError(PassingError):
    """More memory was asked for than there is; the message names the stage and what to reduce (exit code 3)."""


class NoAnswerError(SemscapeError):
    """The input is well formed, but the images do not determine a surface (exit code 3)."""


class TooFewMatchesError(NoAnswerError):
    """Two views, or the whole series, share too few matching keypoints."""


class DegenerateGeometryError(NoAnswerError):
    """The views hold no parallax, or too few tilts to fix the height scale."""


def verdict_of(error: Exception) -> tuple[int, str]:
    """Return the exit code and the message for an exception.

    Examples
    --------
    >>> verdict_of(BadInputError("a.tif: 0 bytes"))
    (2, 'a.tif: 0 bytes')
    """
    linear_algebra = sys.modules.get("numpy.linalg")
    is_numerical = linear_algebra is not None and isinstance(error, linear_algebra.LinAlgError)
    if isinstance(error, MemoryError):
        return 3, f"out of memory{': ' if str(error) else ''}{error}; fewer --workers, or smaller images"
    if isinstance(error, BadInputError):
        return 2, str(error)
    if isinstance(error, SemscapeError):
        return 3, str(error)
    if isinstance(error, ValueError) and not is_numerical:
        return 2, str(error)
    detail = " ".join(str(error).split())
    return 1, f"unexpected {type(error).__name__}{': ' if detail else ''}{detail}; run again with --debug"
