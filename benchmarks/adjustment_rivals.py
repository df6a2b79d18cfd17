"""The same bundle adjustment by others: scipy's least_squares, and COLMAP's (Ceres) through pycolmap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from isolated import timed

if TYPE_CHECKING:
    import numpy as np

    from semscape.sfm.priors import MotionPrior
    from semscape.types import Observations

# A pinhole so far away that a relief of 40 um changes the size of what is seen by 4e-6: parallel but for rounding.
_FOCAL_PX = 1e8
_CAUCHY = 2.385


@dataclass(frozen=True)
class Adjusted:
    """Tilts (V,) rad, seconds, iterations and how it ended."""

    tilt_rad: np.ndarray
    seconds: float
    iterations: int
    status: str


def scipy_adjusted(
    start: np.ndarray, observations: Observations, prior: MotionPrior, sigma_px: float, *, max_evaluations: int
) -> Adjusted:
    """Adjust cameras and points with scipy's least_squares: analytic sparse Jacobian, Cauchy, the same priors."""
    import numpy as np
    from scipy.optimize import least_squares
    from scipy.sparse import coo_array

    from semscape.sfm.models import camera_jacobians

    centre, sigma = prior.centre_and_sigma()
    views, view, point = prior.n_views, observations.view, observations.point
    n_camera, n = len(start), len(view)
    prior_index = np.concatenate([[0], (1 + 6 * np.arange(views)[:, None] + np.arange(4)).ravel()])
    weight = np.where(np.isfinite(sigma), sigma_px / sigma, 0.0)

    def residuals(x: np.ndarray) -> np.ndarray:
        matrices, _, translations = camera_jacobians(x[:n_camera], prior.scale_px_per_um)
        predicted = np.einsum("kij,kj->ki", matrices[view], x[n_camera:].reshape(-1, 3)[point]) + translations[view]
        return np.concatenate([(observations.xy - predicted).ravel(), (x[prior_index] - centre) * weight])

    def jacobian(x: np.ndarray) -> Any:
        matrices, derivatives, _ = camera_jacobians(x[:n_camera], prior.scale_px_per_um)
        world = x[n_camera:].reshape(-1, 3)[point]
        by_matrix = -np.einsum("kpai,ki->kap", derivatives[view], world)
        by_camera = np.concatenate([by_matrix, np.broadcast_to(-np.eye(2), (n, 2, 2))], axis=2)
        own = 1 + 6 * view[:, None] + np.arange(6)
        camera_columns = np.concatenate([np.zeros((n, 1), dtype=np.int64), own], axis=1)
        point_columns = n_camera + 3 * point[:, None] + np.arange(3)
        columns = np.concatenate([camera_columns, point_columns], axis=1)
        values = np.concatenate([by_camera, -matrices[view]], axis=2)
        rows = np.broadcast_to((2 * np.arange(n)[:, None] + np.arange(2))[:, :, None], values.shape)
        every = np.broadcast_to(columns[:, None, :], values.shape)
        prior_rows = 2 * n + np.arange(len(prior_index))
        return coo_array(
            (
                np.concatenate([values.ravel(), weight]),
                (np.concatenate([rows.ravel(), prior_rows]), np.concatenate([every.ravel(), prior_index])),
            ),
            shape=(2 * n + len(prior_index), len(x)),
        ).tocsr()

    first = np.concatenate([start, triangulated(start, observations, prior).ravel()])
    found, seconds = timed(
        least_squares, residuals, first, jac=jacobian, loss="cauchy", f_scale=_CAUCHY * sigma_px, tr_solver="lsmr",
        x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12, max_nfev=max_evaluations,
    )  # fmt: skip
    return Adjusted(found.x[1:n_camera:6], seconds, int(found.nfev), found.message)


def colmap_adjusted(
    start: np.ndarray, observations: Observations, prior: MotionPrior, sigma_px: float, *, threads: int
) -> Adjusted:
    """Adjust cameras and points with COLMAP: pinholes from afar, every rotation and distance free, Cauchy, no priors.

    It knows no parallel projection, no shared axis, no anisotropy and no stage: the distance takes the place of the
    scale, so it can only be compared on tilts that come from the images alone. The tilts are the turns about the
    axis that most of the rotations share, the first view's being that of the start.
    """
    import numpy as np
    import pycolmap
    from scipy.spatial.transform import Rotation

    from semscape.geometry.rotations import tilted_cam_from_world

    views = prior.n_views
    per_view = start[1:].reshape(views, 6)
    rotations = tilted_cam_from_world(start[0], per_view[:, 0], per_view[:, 1])
    world = pycolmap.Reconstruction()
    centre = observations.xy.mean(axis=0)
    world.add_camera_with_trivial_rig(
        pycolmap.Camera(
            model="SIMPLE_PINHOLE", width=1000, height=1000, params=[_FOCAL_PX, *centre.tolist()], camera_id=1
        )
    )
    distance = _FOCAL_PX / prior.scale_px_per_um
    of_view = [np.flatnonzero(observations.view == view) for view in range(views)]
    for view in range(views):
        shift = np.append((per_view[view, 4:] - centre) / prior.scale_px_per_um[view], distance[view])
        points = pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in observations.xy[of_view[view]]])
        image = pycolmap.Image(name=str(view), points2D=points, camera_id=1, image_id=view + 1)
        world.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(rotations[view]), shift))
    place = np.empty(len(observations.view), dtype=np.int64)
    for index in of_view:
        place[index] = np.arange(len(index))
    first = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    for number, xyz in enumerate(triangulated(start, observations, prior)):
        track = pycolmap.Track()
        for k in range(first[number], first[number + 1]):
            track.add_element(int(observations.view[k]) + 1, int(place[k]))
        world.add_point3D(xyz, track)
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=False, refine_principal_point=False, refine_extra_params=False, print_summary=False
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = _CAUCHY * sigma_px
    options.ceres.solver_options.num_threads = threads
    options.ceres.solver_options.gradient_tolerance = 1e-12
    options.ceres.solver_options.function_tolerance = 1e-14
    config = pycolmap.BundleAdjustmentConfig()
    for view in range(views):
        config.add_image(view + 1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, world)
    summary, seconds = timed(adjuster.solve)
    found = np.array([world.image(view + 1).cam_from_world().rotation.matrix() for view in range(views)])
    turns = Rotation.from_matrix(np.swapaxes(found[:1], 1, 2) @ found).as_rotvec()
    axis = np.linalg.svd(turns, full_matrices=False)[2][0]
    tilt = turns @ axis
    ceres = getattr(summary, "ceres_summary", summary)
    steps = int(getattr(ceres, "num_successful_steps", -1)) + int(getattr(ceres, "num_unsuccessful_steps", 0))
    return Adjusted(tilt * np.sign(tilt[-1]) + per_view[0, 0], seconds, steps, str(summary.termination_type))


def triangulated(parameters: np.ndarray, observations: Observations, prior: MotionPrior) -> np.ndarray:
    """Return the points (P, 3) um that suit a motion best."""
    import numpy as np

    from semscape.sfm.models import camera_jacobians
    from semscape.sfm.schur import solve_points

    matrices, _, translations = camera_jacobians(parameters, prior.scale_px_per_um)
    start = np.searchsorted(observations.point, np.arange(observations.n_points + 1))
    xy = np.ascontiguousarray(observations.xy)
    return solve_points(start, observations.view, xy, np.ones(len(xy)), matrices, translations)[0]
