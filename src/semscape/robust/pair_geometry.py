"""The geometry of a pair of views: one model estimated a contrario, or the most meaningful of several."""

from __future__ import annotations

import math

import numpy as np

from semscape.errors import BadInputError, TooFewMatchesError
from semscape.robust.acransac import ac_ransac
from semscape.robust.affine_epipolar import is_planar
from semscape.robust.models import AFFINE, FUNDAMENTAL, HOMOGRAPHY, Model, Shape, essential
from semscape.robust.parallax import limit_parallax
from semscape.robust.search import RobustFit
from semscape.types import FloatArray, TiltSeries, TwoViewGeometry

_LEAST_FOR_PLANE = 8


def two_view_geometry(
    pair: tuple[int, int],
    x1: FloatArray,
    x2: FloatArray,
    *,
    kind: str,
    shapes: tuple[Shape, Shape],
    rng: np.random.Generator,
    max_trials: int,
    calibrations: tuple[FloatArray, FloatArray] | None = None,
    parallax_limited: bool = False,
) -> TwoViewGeometry:
    """Estimate the geometry of a pair of views from its putative matches.

    Parameters
    ----------
    pair : (int, int)
        View indices i1 < i2.
    x1, x2 : (M, 2) float arrays
        Matched points in px.
    kind : str
        "affine", "fundamental", "homography", "essential", or "auto" for the one of least NFA. A homography explains
        a match in two dimensions, the others in one, so that it wins wherever the relief is low; the points that
        stand out of its plane are then no inliers, and "auto" is no setting for reconstruction.
    shapes : ((int, int), (int, int))
        Height and width of the two images in px.
    rng : numpy.random.Generator
    max_trials : int
        Largest number of samples, for each model.
    calibrations : ((3, 3), (3, 3)) float arrays, optional
        Of the two cameras in px; "essential" needs them, "auto" tries it where they are given.
    parallax_limited : bool
        Drop inliers of the affine model by their parallax, see `semscape.robust.parallax`.

    Returns
    -------
    TwoViewGeometry
        `log10_nfa_by_kind` holds the figure of every model that was tried; `planar` tells whether the inliers show
        no parallax, so that no epipolar geometry is better than another.

    Raises
    ------
    BadInputError
        For "essential" without calibrations.
    TooFewMatchesError
        When no model can be estimated from the matches.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x1 = rng.uniform(0, 500, (300, 2))
    >>> x2 = x1 * 1.02 + rng.normal(0, 0.3, (300, 2))  # a plane
    >>> shapes = ((500, 500), (500, 500))
    >>> found = two_view_geometry((0, 1), x1, x2, kind="auto", shapes=shapes, rng=rng, max_trials=500)
    >>> found.kind, found.planar, found.nfa_margin > 100
    ('homography', True, True)
    """
    fits: dict[str, RobustFit] = {}
    problems = []
    for model in _models(kind, calibrations):
        try:
            fits[model.kind] = ac_ransac(model, x1, x2, shapes=shapes, rng=rng, max_trials=max_trials)
        except TooFewMatchesError as problem:
            problems.append(problem)
    if not fits:
        raise problems[0]
    best = min(fits.values(), key=lambda fit: fit.log10_nfa)
    if parallax_limited and best.kind == "affine":
        best = limit_parallax(best, x1, x2, shapes)
    inliers = np.hstack([x1, x2])[best.inliers]
    return TwoViewGeometry(
        pair,
        best.kind,
        best.matrix,
        best.inliers,
        best.residual_px,
        best.threshold_px,
        best.log10_nfa,
        best.n_trials,
        {name: fit.log10_nfa for name, fit in fits.items()} | {best.kind: best.log10_nfa},
        len(inliers) >= _LEAST_FOR_PLANE and is_planar(inliers),
    )


def pinhole_calibrations(series: TiltSeries) -> list[FloatArray]:
    """Return for each view the 3 x 3 matrix in px of a SEM seen as a pinhole camera at its working distance.

    Raises
    ------
    BadInputError
        Where the working distance or the pixel size of a view is not known.
    """
    height, width = series.shape
    found = []
    for view in series.views:
        focal_px = view.metadata.working_distance_um / view.metadata.pixel_size_um
        if not math.isfinite(focal_px):
            raise BadInputError(
                f"{view.name}: option robust.model is 'essential', which needs the working distance and the pixel "
                "size of every image, and this one tells no such figures; use robust.model = 'affine'"
            )
        found.append(np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]]))
    return found


def _models(kind: str, calibrations: tuple[FloatArray, FloatArray] | None) -> list[Model]:
    models = {model.kind: model for model in (AFFINE, FUNDAMENTAL, HOMOGRAPHY)}
    if calibrations is not None:
        models["essential"] = essential(*calibrations)
    elif kind == "essential":
        raise BadInputError("an essential matrix needs the calibrations of both cameras; use 'affine' without them")
    if kind == "auto":
        return list(models.values())
    if kind not in models:
        raise ValueError(f"model {kind!r} is unknown, known are {[*models, 'auto']}")
    return [models[kind]]
