"""Motion of the series and sparse points: tracks, Differential Evolution, bundle adjustment."""
