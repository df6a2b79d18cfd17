"""The command line.

Exit codes: 0 done, 1 a fault of semscape itself, 2 bad input or usage, 3 the data give no answer, 130
interrupted. What a command needs is imported when it runs, so that `semscape --help` is quick. No flag has
a default of its own: a flag that is not given leaves the value to the options file, then to options.py.
"""

from semscape.cli.application import app, main

# Importing a module of commands adds them to the application, in this order.
from semscape.cli import surface, many, measured, simulated, keypoints, learning  # isort: skip

__all__ = ["app", "keypoints", "learning", "main", "many", "measured", "simulated", "surface"]
