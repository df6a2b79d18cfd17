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
    if isinstance(error, BadInputError):
        return 2, str(error)
    if isinstance(error, SemscapeError):
        return 3, str(error)
    if isinstance(error, ValueError) and not is_numerical:
        return 2, str(error)
    detail = " ".join(str(error).split())
    return 1, f"unexpected {type(error).__name__}{': ' if detail else ''}{detail}; run again with --debug"
