from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from semscape.report.figures import height_picture, hillshade_picture, tilt_picture
from synthetic_result import make_result

RESULT = make_result()


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))


def test_pictures_are_the_same_bytes_on_every_run() -> None:
    assert height_picture(RESULT.height_map) == height_picture(RESULT.height_map)


def test_pictures_do_not_depend_on_the_users_matplotlib_settings() -> None:
    import matplotlib

    before = height_picture(RESULT.height_map)
    with matplotlib.rc_context({"image.cmap": "jet", "font.size": 30, "axes.facecolor": "red"}):
        assert height_picture(RESULT.height_map) == before


def test_the_ground_is_transparent_and_the_surface_is_not() -> None:
    picture = pixels(hillshade_picture(RESULT.height_map))
    assert picture[0, 0, 3] == 0
    assert picture[picture.shape[0] // 2, picture.shape[1] // 2, 3] == 255


def test_the_peak_is_drawn_where_the_world_says() -> None:
    # A lone tower in the upper right must end up in the upper right.
    height = np.zeros((40, 60))
    height[5:9, 50:54] = 10.0
    shown = pixels(height_picture(replace(RESULT.height_map, height_um=height))).astype(int)
    yellow = (shown[..., 0] > 220) & (shown[..., 1] > 200) & (shown[..., 2] < 90)
    rows, columns = np.nonzero(yellow[:, : int(0.84 * shown.shape[1])])
    assert rows.mean() < 0.35 * shown.shape[0]
    assert columns.mean() > 0.6 * shown.shape[1]


def test_tilts_without_a_stage_and_long_names() -> None:
    free = replace(RESULT.reconstruction, tilt_prior_rad=np.full(3, np.nan))
    names = ("a" * 80 + ".tif", "$x_1$.tif", "c.tif")
    assert pixels(tilt_picture(free, names, 0.1)).size
