"""Compare a result with a truth: alignment, errors of heights, surfaces and tilts, in um, px and percent of relief."""
