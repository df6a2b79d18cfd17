"""Stop between two stages: look at matches and tracks, and calibrate without making a dense surface.

Every stage is a function from values to a new value; `semscape.reconstruct` only calls them in order. A small
simulated series stands in for `semscape.load_series(folder)`.
"""

import numpy as np

from semscape.features.detect import detect
from semscape.options import Options
from semscape.sfm.calibrate import calibrate
from semscape.sfm.tracks import build_tracks
from semscape.sfm.two_view import match_pair
from semscape.simulate import SimulationOptions, simulate


def main() -> None:
    """Run the stages up to the sparse points, by hand."""
    options = Options()
    small = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=320, height_px=320)
    series, truth = simulate("fracture", small, rng=1)

    keypoints = tuple(detect(view, options.features) for view in series.views)
    print("keypoints per view:", [len(found) for found in keypoints])

    pairs = ((0, 1), (0, 2), (1, 2))
    found = [
        match_pair(
            pair, keypoints, series.names, series.shape, options.features, options.robust, np.random.default_rng(0)
        )
        for pair in pairs
    ]
    matches, geometries = zip(*found, strict=True)
    for putative, geometry in found:
        print(
            f"pair {geometry.pair}: {geometry.inliers.sum()} of {len(putative)} matches within "
            f"{geometry.threshold_px:.2f} px of their epipolar lines"
        )

    # Here is the place to look at matches, to drop some, or to put in one's own.
    observations = build_tracks(keypoints, matches, geometries)
    calibration = calibrate(series, observations, options.sfm, rng=np.random.default_rng(0))
    motion = calibration.reconstruction.motion
    print("tilts (deg):", np.rad2deg(motion.tilt_rad).round(3), "true:", np.rad2deg(truth.motion.tilt_rad).round(3))
    print("sparse points:", calibration.reconstruction.points_um.shape)


if __name__ == "__main__":
    main()
