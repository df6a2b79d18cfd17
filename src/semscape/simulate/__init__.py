"""The simulated scanning electron microscope: specimens, renderer, faults, exact truth."""

from semscape.simulate.presets import PRESETS, SimulationOptions
from semscape.simulate.series import simulate
from semscape.simulate.specimens import SPECIMENS, Specimen, SpecimenSize

__all__ = ["PRESETS", "SPECIMENS", "SimulationOptions", "Specimen", "SpecimenSize", "simulate"]
