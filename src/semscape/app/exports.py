"""What can be saved of a run: the formats of `semscape convert`, named here so that the server need not load them."""

from __future__ import annotations

FORMAT_NAMES = (
    *("ply", "stl", "obj", "glb", "off", "3mf"),
    *("x3p", "sdf", "gwy", "gsf", "sur", "tif", "npz", "csv", "xyz", "vts"),
    *("print", "anaglyph", "side-by-side"),
)
"""Keys of `semscape.report.conversion.FORMATS`, in its order."""
