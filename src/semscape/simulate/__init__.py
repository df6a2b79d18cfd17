"""The simulated scanning electron microscope: specimens, renderer, faults, exact truth."""

from semscape.simulate.given import fit_pixel_size, specimen_from_surface
from semscape.simulate.mesh import MeshSpecimen
from semscape.simulate.presets import PRESETS, SimulationOptions
from semscape.simulate.series import Acquisition, acquire, simulate
from semscape.simulate.specimens import SPECIMENS, Specimen, SpecimenSize

__all__ = [
    "PRESETS",
    "SPECIMENS",
    "Acquisition",
    "MeshSpecimen",
    "SimulationOptions",
    "Specimen",
    "SpecimenSize",
    "acquire",
    "fit_pixel_size",
    "simulate",
    "specimen_from_surface",
]
