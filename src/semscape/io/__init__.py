"""Files in and out: micrographs, the vendors' metadata, tilt series."""
