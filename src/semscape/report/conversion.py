"""`semscape convert`: write the surface of a run in the formats of other programs."""

from __future__ import annotations

import logging
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from semscape.dense.mesh import height_map_mesh, with_picture
from semscape.dense.print_body import plate_side, print_body
from semscape.errors import BadInputError, NoAnswerError
from semscape.io.digital_surf import encode_sur
from semscape.io.finished_run import read_finished_run
from semscape.io.gwyddion import encode_gsf, encode_gwy
from semscape.io.height_text import encode_csv, encode_xyz
from semscape.io.iso25178_files import encode_sdf, encode_x3p
from semscape.io.mesh_files import encode_3mf, encode_obj, encode_off, encode_stl
from semscape.io.paraview import encode_vts
from semscape.io.run_folder import put_files
from semscape.io.surfaces import (
    NEEDS_PIXEL_SIZE,
    MeshUnit,
    encode_height_map_npz,
    encode_height_map_tif,
    encode_mesh_glb,
    encode_mesh_ply,
)
from semscape.options import ConvertOptions, MeshOptions
from semscape.report.stereo_picture import anaglyph_png, rectified_pair, side_by_side_png
from semscape.types import FloatArray, HeightMap, SurfaceMesh

_log = logging.getLogger(__name__)

_HEAD_BYTES = 65536
_BLACK = np.zeros(3, np.uint8)


@dataclass(frozen=True, eq=False)
class _Source:
    """What every format is made from: a run, its height map, when it was made, and what is asked for."""

    path: Path
    name: str
    height_map: HeightMap
    created: datetime
    options: ConvertOptions
    images: Path | None

    @property
    def unit(self) -> MeshUnit | None:
        return cast("MeshUnit", self.options.unit) if self.options.unit else None

    @cached_property
    def mesh(self) -> SurfaceMesh:
        mesh = height_map_mesh(self.height_map, max_vertices=self.options.max_vertices)
        if not len(mesh.faces):
            raise NoAnswerError(f"{self.path}: the heights have too many gaps for a single triangle of a mesh")
        if self.options.color == "micrograph":
            return with_picture(mesh, self.height_map, MeshOptions().texture_px)
        return replace(mesh, color=_colors(mesh.vertices_um[:, 2], self.height_map, self.options.color))


def _obj(source: _Source) -> dict[str, bytes]:
    height_map = source.height_map
    mesh = with_picture(source.mesh, height_map, max(height_map.height_um.shape))
    assert mesh.uv is not None  # for so it was made
    assert mesh.picture is not None
    picture = np.repeat(mesh.picture[..., None], 3, axis=-1)
    if source.options.color != "micrograph":
        picture = _colors(height_map.height_um, height_map, source.options.color)
    return encode_obj(mesh, mesh.uv, picture, source.name, source.unit)


def _print(source: _Source) -> dict[str, bytes]:
    """Return the printable body as STL in mm."""
    options, height_map = source.options, source.height_map
    if np.isnan(options.print_scale):
        mm_per_unit = options.print_size_mm / plate_side(height_map, options.max_vertices)
    elif height_map.length_unit == "px":
        raise BadInputError(f"the run has no pixel size, so --print-scale means nothing; give --print-size-mm, or "
                            f"{NEEDS_PIXEL_SIZE}")  # fmt: skip
    else:
        mm_per_unit = options.print_scale * 1e-3
    body = print_body(height_map, base=options.base_mm / mm_per_unit, max_vertices=options.max_vertices)
    # The body's numbers are now mm of plastic, so "um" times 1000 is what the writer turns into mm.
    scaled = replace(body, vertices_um=body.vertices_um * mm_per_unit * 1e3, length_unit="um")
    note = f"print {mm_per_unit * 1e3:.6g}:1" if height_map.length_unit == "um" else f"print {mm_per_unit:.6g} mm/px"
    return {f"{source.name}-print.stl": encode_stl(scaled, "mm", note)}


def _anaglyph(source: _Source) -> dict[str, bytes]:
    return {f"{source.name}-anaglyph.png": anaglyph_png(*_pair(source))}


def _side_by_side(source: _Source) -> dict[str, bytes]:
    return {f"{source.name}-side-by-side.png": side_by_side_png(*_pair(source))}


def _pair(source: _Source) -> tuple[FloatArray, FloatArray, str]:
    if source.images is None:
        raise BadInputError(
            "a run folder holds no images: give the folder of the series with --images for a stereo picture"
        )
    return rectified_pair(source.path, source.images, source.height_map.pixel_size_um, source.options.stereo_angle_deg)


def _single(suffix: str, encode: Callable[[_Source], bytes]) -> Callable[[_Source], dict[str, bytes]]:
    return lambda source: {f"{source.name}.{suffix}": encode(source)}


FORMATS: dict[str, Callable[[_Source], dict[str, bytes]]] = {
    "ply": _single("ply", lambda source: encode_mesh_ply(source.mesh, source.unit)),
    "stl": _single("stl", lambda source: encode_stl(source.mesh, source.unit)),
    "obj": _obj,
    "glb": _single("glb", lambda source: encode_mesh_glb(source.mesh, source.unit)),
    "off": _single("off", lambda source: encode_off(source.mesh, source.unit)),
    "3mf": _single("3mf", lambda source: encode_3mf(source.mesh, source.unit)),
    "x3p": _single("x3p", lambda source: encode_x3p(source.height_map, source.created)),
    "sdf": _single("sdf", lambda source: encode_sdf(source.height_map, source.created)),
    "gwy": _single("gwy", lambda source: encode_gwy(source.height_map)),
    "gsf": _single("gsf", lambda source: encode_gsf(source.height_map)),
    "sur": _single("sur", lambda source: encode_sur(source.height_map, source.created)),
    "tif": _single("tif", lambda source: encode_height_map_tif(source.height_map)),
    "npz": _single("npz", lambda source: encode_height_map_npz(source.height_map)),
    "csv": _single("csv", lambda source: encode_csv(source.height_map)),
    "xyz": _single("xyz", lambda source: encode_xyz(source.height_map)),
    "vts": _single("vts", lambda source: encode_vts(source.height_map)),
    "print": _print,
    "anaglyph": _anaglyph,
    "side-by-side": _side_by_side,
}
_MESHES = ("ply", "stl", "obj", "glb", "off", "3mf")
_COLOURED = ("ply", "obj", "glb")
_METRES = ("x3p", "sdf", "gwy", "gsf")
# Fields of the options, their flags, and the formats that heed them.
_HEEDED = {
    "unit": ("--unit", _MESHES),
    "color": ("--color", _COLOURED),
    "max_vertices": ("--max-vertices", (*_MESHES, "print")),
    "print_scale": ("--print-scale", ("print",)),
    "print_size_mm": ("--print-size-mm", ("print",)),
    "base_mm": ("--base-mm", ("print",)),
}
_SAME_SUFFIX = {".tiff": ".tif"}
_SUFFIXES = {".print": ".stl", ".anaglyph": ".png", ".side-by-side": ".png"}


def convert(
    run: Path | str,
    formats: Sequence[str],
    output: Path | str | None = None,
    options: ConvertOptions | None = None,
    *,
    images: Path | str | None = None,
) -> tuple[Path, ...]:
    """Write the surface of a run in other programs' formats: all of the files or, after an error, none.

    Parameters
    ----------
    run : path
        Run folder of `semscape reconstruct`, or a height_map.npz.
    formats : sequence of str
        Keys of `FORMATS`.
    output : path
        A folder, in which files are named after the run; or a file, for a single format whose suffix it has. Left
        out: the folder `converted` in the run folder, or beside the height_map.npz.
    options : ConvertOptions, optional
        Units, colours, scales.
    images : path, optional
        Folder of the series, for the stereo pictures.

    Returns
    -------
    tuple of path
        The files written.

    Raises
    ------
    BadInputError
        For an unknown format, an option that none of the formats heeds, a unit that a format cannot hold, a run without
        the pixel size that a format needs, an output that cannot be written, or one that is not an earlier output of
        semscape.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise BadInputError(f"--to {','.join(unknown) or '(empty)'} is not known; there are: {', '.join(FORMATS)}")
    options = options or ConvertOptions()
    notes = _notes(formats, options)
    path = Path(run)
    output = (path.parent if path.is_file() else path) / "converted" if output is None else Path(output)
    folder, name = _target(list(dict.fromkeys(formats)), output)
    height_map = read_finished_run(path).height_map
    archive = path if path.is_file() else path / "height_map.npz"
    # The time of the heights, not of the conversion: the same run gives the same bytes.
    created = datetime.fromtimestamp(int(archive.stat().st_mtime), UTC)
    source = _Source(path, name or _name(path), height_map, created, options, Path(images) if images else None)
    files: dict[str, bytes] = {}
    for key in dict.fromkeys(formats):
        files |= FORMATS[key](source)
    if name is not None and len(files) == 1:
        (content,) = files.values()
        files = {output.name: content}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"the output folder {folder} cannot be made: {error.strerror or error}") from error
    for file in files:
        _require_own(folder / file)
    put_files(files, folder)
    for note in notes:
        _log.warning(note)
    return tuple(folder / file for file in files)


def _notes(formats: Sequence[str], options: ConvertOptions) -> list[str]:
    """Return what the formats do not hold of what was asked for; refuse what none of them heeds."""
    for field, (flag, heeding) in _HEEDED.items():
        value, default = getattr(options, field), getattr(ConvertOptions(), field)
        if value != default and value == value and not set(formats) & set(heeding):
            raise BadInputError(
                f"{flag} {value} changes nothing for {', '.join(formats)}{_held(formats) if field == 'unit' else ''}; "
                f"leave it out, or ask for {' or '.join(heeding)}"
            )
    notes = []
    others = [name for name in dict.fromkeys(formats) if name not in _MESHES]
    if options.unit and others:
        notes.append(f"--unit {options.unit} is that of the meshes alone{_held(others)}")
    if bare := [name for name in dict.fromkeys(formats) if name in _MESHES and name not in _COLOURED]:
        what = "the micrograph is" if options.color == "micrograph" else f"--color {options.color} is"
        notes.append(f"{what} left out of {', '.join(bare)}: no colours are written there; ply, obj and glb have them")
    return notes


def _held(formats: Sequence[str]) -> str:
    """Say in which unit the formats that are no meshes hold their lengths."""
    metres = [name for name in formats if name in _METRES]
    own = [name for name in formats if name not in (*_METRES, *_MESHES, "print", "anaglyph", "side-by-side")]
    parts = [f"{', '.join(metres)} in metres, as the format has it"] if metres else []
    parts += [f"{', '.join(own)} in um"] if own else []
    parts += ["the print is in mm"] if "print" in formats else []
    return f" ({'; '.join(parts)})" if parts else ""


def _name(run: Path) -> str:
    resolved = run.resolve()
    return resolved.stem if resolved.is_file() else resolved.name or "semscape"


def _target(formats: list[str], output: Path) -> tuple[Path, str | None]:
    """Return the folder to write into, and the stem of the file where a file is meant."""
    suffix = output.suffix.lower()
    suffix = _SAME_SUFFIX.get(suffix, suffix)
    suffixes = {_SUFFIXES.get(f".{name}", f".{name}") for name in FORMATS}
    if output.is_dir() or suffix not in suffixes:
        if output.exists() and not output.is_dir():
            raise BadInputError(f"the output folder {output} cannot be made: a file stands in its place")
        return output, None
    own = _SUFFIXES.get(f".{formats[0]}", f".{formats[0]}")
    if len(formats) > 1 or suffix != own:
        raise BadInputError(f"-o {output} is one {suffix} file, but --to asks for {', '.join(formats)}; give a folder")
    return output.parent, output.stem


def _require_own(path: Path) -> None:
    """Refuse to replace what semscape did not write; every file that it writes bears its name near the beginning."""
    try:
        if not path.exists():
            return
        if path.is_file() and zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                is_own = "world_from_grid.npy" in archive.namelist()
                for member in archive.namelist():
                    with archive.open(member) as file:
                        is_own = is_own or b"semscape" in file.read(_HEAD_BYTES)
        elif path.is_file():
            with path.open("rb") as file:
                is_own = b"semscape" in file.read(_HEAD_BYTES)
        else:
            is_own = False
    except (OSError, zipfile.BadZipFile) as error:
        raise BadInputError(f"{path} is there already and cannot be read: {error}; give another name") from error
    if not is_own:
        raise BadInputError(f"{path} is there already and was not written by semscape; give another name or folder")


def _colors(height: FloatArray, height_map: HeightMap, name: str) -> NDArray[np.uint8]:
    """Return height.shape + (3,) colours between the 0.5 and 99.5 percentiles of the map's heights, unknown black."""
    import matplotlib

    if name not in matplotlib.colormaps:
        raise BadInputError(f"--color {name!r} is neither micrograph nor a colour map of matplotlib, like viridis")
    low, high = np.nanpercentile(height_map.height_um, [0.5, 99.5])
    share = np.clip((height - low) / max(high - low, 1e-12), 0, 1)
    rgba = matplotlib.colormaps[name](np.nan_to_num(share), bytes=True)
    return np.where(np.isfinite(height)[..., None], rgba[..., :3], _BLACK)
