"""The surface container: all that the viewer shows of a run in one compact file (docs/viewer.md).

Heights are whole multiples of a step far below their uncertainty, and every plane is written as differences to what
its neighbours foretell, deflated: a map of 1024 x 1024 takes about a megabyte. Browsers unpack it without a library.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.geometry.rotations import tilted_cam_from_world
from semscape.types import FloatArray, HeightMap, ImageArray, Motion, Reason, Result

SURFACE_MAGIC = b"SEMSURF1"

_STEPS_PER_SIGMA = 16
_FEWEST_STEPS, _MOST_STEPS = 2.0**14, 2.0**24  # over the range of heights
_SIGMA_CODES = 254  # 2 .. 255; 0 is no height, 1 a height without uncertainty
_LEAST_SIGMA_RATIO = 1.03
_MOST_POINTS = 8000
_POINT_STEPS = 65535
_JPEG_QUALITY = 82


@dataclass(frozen=True, eq=False)
class Camera:
    """A view of the series for the viewer: `rotation` (3, 3) is camera from world, of a parallel projection."""

    name: str
    tilt_deg: float
    tilt_sigma_deg: float
    rotation: FloatArray
    reference: bool


def surface_of_result(result: Result, most_heights: int | None = None) -> bytes:
    """Return the surface container of a run that is in memory; see `encode_surface`."""
    found = result.reconstruction
    return encode_surface(
        result.height_map,
        name=f"{result.series.names[0]} … {result.series.names[-1]}",
        cameras=cameras_of(found.motion, found.reference, result.series.names, found.tilt_sigma_rad),
        points_um=found.points_um,
        height_scale_relative_sigma=found.height_scale_relative_sigma,
        most_heights=most_heights,
    )


def cameras_of(
    motion: Motion, reference: int, names: Sequence[str], tilt_sigma_rad: FloatArray | None = None
) -> tuple[Camera, ...]:
    """Return the cameras of a calibrated series; without `tilt_sigma_rad` (V,) their sigmas are unknown."""
    rotations = tilted_cam_from_world(motion.axis_angle_rad, motion.tilt_rad, motion.roll_rad)
    sigmas = np.full(motion.n_views, np.nan) if tilt_sigma_rad is None else np.rad2deg(tilt_sigma_rad)
    tilts = np.rad2deg(motion.tilt_rad)
    return tuple(
        Camera(name, float(tilts[i]), float(sigmas[i]), rotations[i], i == reference) for i, name in enumerate(names)
    )


def encode_surface(
    height_map: HeightMap,
    *,
    name: str = "",
    cameras: Sequence[Camera] = (),
    points_um: FloatArray | None = None,
    height_scale_relative_sigma: float = np.nan,
    most_heights: int | None = None,
) -> bytes:
    """Return the surface container of a height map.

    Parameters
    ----------
    height_map : HeightMap
        Its heights are rounded to a sixteenth of the fifth percentile of their sigmas, or less.
    name : str
        What the viewer calls it.
    cameras : sequence of Camera
        The views of the series.
    points_um : (P, 3) float array, optional
        Sparse points in the world; at most 8,000 of them, evenly taken, are kept.
    height_scale_relative_sigma : float
        Relative sigma that all heights share; NaN is unknown.
    most_heights : int, optional
        Keep every n-th row and column, such that at most so many remain; all where left out.

    Examples
    --------
    >>> rows, cols = np.indices((20, 30))
    >>> flat = HeightMap(0.1 * cols, np.full((20, 30), 0.05), np.ones((20, 30), np.uint8),
    ...                  np.zeros((20, 30), np.float32), 0.5, np.diag([0.5, -0.5, 1.0, 1.0]), "um")
    >>> read = decode_surface(encode_surface(flat))
    >>> bool(np.abs(read.height_um - flat.height_um).max() <= 0.05 / 16 / 2)
    True
    """
    stride = _stride(height_map.height_um.shape, most_heights)
    height, sigma = height_map.height_um[::stride, ::stride], height_map.uncertainty_um[::stride, ::stride]
    n_views, texture = height_map.n_views[::stride, ::stride], height_map.texture[::stride, ::stride]
    known = np.isfinite(height)
    origin, step = _height_scale(height[known], sigma[known])
    codes, sigma_origin, sigma_ratio = _sigma_codes(known, sigma)
    height_plane, height_bytes = _height_plane(height, known, origin, step)
    points, points_origin, points_step = _point_plane(points_um)
    planes = {
        "height": _deflated(height_plane),
        "sigma": _deflated(_delta(codes)),
        "n_views": _deflated(_delta(np.where(known, n_views, 0).astype(np.uint8))),
        "points": _deflated(points),
    }
    reason = height_map.reason[::stride, ::stride]
    told = {int(code): Reason(code).name.lower().replace("_", " ") for code in np.unique(reason[~known])}
    if set(told) - {Reason.NOT_TOLD}:
        planes["reason"] = _deflated(_delta(np.where(known, Reason.KNOWN, reason).astype(np.uint8)))
    if np.isfinite(texture).any():
        planes["micrograph"] = _jpeg(texture)
    rows, cols = height.shape
    header = {
        "name": name,
        "rows": rows,
        "cols": cols,
        "length_unit": height_map.length_unit,
        "pixel_size": height_map.pixel_size_um * stride,
        "world_from_grid": (height_map.world_from_grid @ np.diag([stride, stride, 1.0, 1.0])).ravel().tolist(),
        "stride": stride,
        "full_shape": list(height_map.height_um.shape),
        "height_origin": origin,
        "height_step": step,
        "height_bytes": height_bytes,
        "sigma_origin": sigma_origin,
        "sigma_ratio": sigma_ratio,
        "reasons": {str(code): name for code, name in told.items()},
        "height_scale_relative_sigma": _finite(height_scale_relative_sigma),
        "cameras": [
            {
                "name": camera.name,
                "tilt_deg": camera.tilt_deg,
                "tilt_sigma_deg": _finite(camera.tilt_sigma_deg),
                "rotation": camera.rotation.ravel().tolist(),
                "reference": camera.reference,
            }
            for camera in cameras
        ],
        "points_origin": points_origin,
        "points_step": points_step,
    }
    return _packed(header, planes)


def decode_surface(content: bytes) -> HeightMap:
    """Return the height map in a surface container, heights and sigmas as they were rounded; without its texture.

    Raises
    ------
    ValueError
        If the bytes are no surface container.
    """
    if content[:8] != SURFACE_MAGIC:
        raise ValueError("these bytes are no surface container of semscape")
    (length,) = struct.unpack("<I", content[8:12])
    header: dict[str, Any] = json.loads(content[12 : 12 + length])
    shape = header["rows"], header["cols"]

    def plane(name: str) -> NDArray[np.uint8]:
        place = header["planes"][name]
        first = 12 + length + place["offset"]
        return np.frombuffer(zlib.decompress(content[first : first + place["length"]]), np.uint8)

    codes, n_views = (_undelta(plane(name).reshape(shape)) for name in ("sigma", "n_views"))
    parts = plane("height").reshape(header["height_bytes"], *shape).astype(np.uint32)
    zigzag = sum((part << np.uint32(8 * i) for i, part in enumerate(parts)), start=np.zeros(shape, np.uint32))
    residual = (zigzag >> np.uint32(1)).astype(np.int64) ^ -(zigzag & np.uint32(1)).astype(np.int64)
    steps = residual.cumsum(axis=0).cumsum(axis=1)
    sigma = header["sigma_origin"] * header["sigma_ratio"] ** (codes.astype(np.float64) - 2)
    reason = _undelta(plane("reason").reshape(shape)) if "reason" in header["planes"] else np.empty((0, 0), np.uint8)
    return HeightMap(
        height_um=np.where(codes > 0, header["height_origin"] + header["height_step"] * steps, np.nan),
        uncertainty_um=np.where(codes > 1, sigma, np.nan),
        n_views=n_views,
        texture=np.full(shape, np.nan, np.float32),
        pixel_size_um=header["pixel_size"],
        world_from_grid=np.array(header["world_from_grid"]).reshape(4, 4),
        length_unit=header["length_unit"],
        reason=reason,
    )


def _stride(shape: tuple[int, ...], most_heights: int | None) -> int:
    stride = 1
    while most_heights and -(-shape[0] // stride) * -(-shape[1] // stride) > most_heights:
        stride += 1
    return stride


def _height_scale(height: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """Return the lowest height, and the step: far below the uncertainty, and fine and coarse enough for the range."""
    if not height.size:
        return 0.0, 1.0
    low, extent = float(height.min()), float(np.ptp(height))
    sigma = sigma[np.isfinite(sigma) & (sigma > 0)]
    step = float(np.percentile(sigma, 5)) / _STEPS_PER_SIGMA if sigma.size else 0.0
    step = min(max(step, extent / _MOST_STEPS), extent / _FEWEST_STEPS)
    return low, step or 1.0


def _height_plane(height: FloatArray, known: NDArray[np.bool_], origin: float, step: float) -> tuple[bytes, int]:
    """Return the byte planes, lowest first, of the zigzag residuals of left + above - above left, and their number."""
    steps = np.rint((np.where(known, height, origin) - origin) / step).astype(np.int64)
    # An unknown height takes over its left neighbour's, and so costs no bytes; the code of its sigma tells it is none.
    last = np.maximum.accumulate(np.where(known, np.arange(height.shape[1]), 0), axis=1)
    steps = np.take_along_axis(steps, last, axis=1)
    residual = np.diff(np.diff(steps, axis=0, prepend=0), axis=1, prepend=0)
    zigzag = (np.abs(residual) * 2 - (residual < 0)).astype(np.uint32)
    n_bytes = max(1, -(-int(zigzag.max(initial=0)).bit_length() // 8))
    return b"".join(
        ((zigzag >> np.uint32(8 * i)) & np.uint32(255)).astype(np.uint8).tobytes() for i in range(n_bytes)
    ), n_bytes


def _sigma_codes(known: NDArray[np.bool_], sigma: FloatArray) -> tuple[NDArray[np.uint8], float, float]:
    """Return logarithmic codes (H, W) of the sigmas, the value of code 2, and the ratio of neighbours."""
    stated = known & np.isfinite(sigma) & (sigma > 0)
    codes = known.astype(np.uint8)
    if not stated.any():
        return codes, 1.0, _LEAST_SIGMA_RATIO
    low, high = float(sigma[stated].min()), float(sigma[stated].max())
    ratio = max(_LEAST_SIGMA_RATIO, (high / low) ** (1 / (_SIGMA_CODES - 1)))
    codes[stated] = 2 + np.rint(np.log(sigma[stated] / low) / np.log(ratio)).astype(np.uint8)
    return codes, low, ratio


def _point_plane(points_um: FloatArray | None) -> tuple[bytes, list[float], list[float]]:
    points = np.empty((0, 3)) if points_um is None else points_um[np.isfinite(points_um).all(axis=1)]
    if not len(points):
        return b"", [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]
    points = points[:: -(-len(points) // _MOST_POINTS)]
    low = points.min(axis=0)
    step = np.maximum(np.ptp(points, axis=0) / _POINT_STEPS, np.finfo(np.float32).tiny)
    return np.rint((points - low) / step).astype("<u2").tobytes(), low.tolist(), step.tolist()


def _delta(plane: NDArray[np.uint8]) -> bytes:
    """Return differences to the left, in the first column to above; bytes wrap around."""
    difference = np.diff(plane, axis=1, prepend=np.uint8(0))
    difference[:, :1] = np.diff(plane[:, :1], axis=0, prepend=np.uint8(0))
    return difference.tobytes()


def _undelta(difference: NDArray[np.uint8]) -> NDArray[np.uint8]:
    plane = difference.copy()
    plane[:, 0] = plane[:, 0].cumsum(dtype=np.uint8)
    restored: NDArray[np.uint8] = plane.cumsum(axis=1, dtype=np.uint8)
    return restored


def _jpeg(texture: ImageArray) -> bytes:
    from PIL import Image

    known = texture[np.isfinite(texture)]
    low, high = np.percentile(known, [0.5, 99.5])
    scaled = (np.nan_to_num(texture, nan=float(low)) - low) / max(float(high - low), 1e-12)
    stream = io.BytesIO()
    grey = np.rint(255 * np.clip(scaled, 0.0, 1.0)).astype(np.uint8)
    Image.fromarray(grey).save(stream, "jpeg", quality=_JPEG_QUALITY, optimize=True)
    return stream.getvalue()


def _deflated(content: bytes) -> bytes:
    return zlib.compress(content, 9)


def _packed(header: Mapping[str, Any], planes: Mapping[str, bytes]) -> bytes:
    places, offset = {}, 0
    for name, content in planes.items():
        places[name] = {"offset": offset, "length": len(content)}
        offset += len(content)
    text = json.dumps({**header, "planes": places}, ensure_ascii=False, allow_nan=False).encode()
    return b"".join((SURFACE_MAGIC, struct.pack("<I", len(text)), text, *planes.values()))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
