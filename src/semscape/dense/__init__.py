"""From a calibrated series to one height map and mesh: rectify, match pairs, fuse, refine over all views."""
