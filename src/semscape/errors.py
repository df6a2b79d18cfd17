"""What can go wrong with data, by meaning.

Misuse of the library (a wrong type, a wrong shape) raises `TypeError` or `ValueError`. Data that cannot
give an answer raises a subclass of `SemscapeError`, whose message names the file or view, the figure and
the way out. The command line turns `BadInputError` into exit code 2 and every other one into 3.
"""

from __future__ import annotations


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
