"""Which experiments there are, in the order of the thesis, and how they are run."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType

from semscape.errors import BadInputError, SemscapeError
from semscape.experiments.study import Experiment, Setting

ALL = "all"
# Sections 2.3 and 2.4 of the thesis, then 3.4 to 3.8. A module is imported when its experiment runs.
EXPERIMENTS: Mapping[str, str] = MappingProxyType(
    {
        "matching": "semscape.experiments.matching:run",
        "features": "semscape.experiments.features:run",
        "surfaces": "semscape.experiments.surfaces:run",
        "calibration": "semscape.experiments.calibration:run",
        "convergence": "semscape.experiments.convergence:run",
        "significance": "semscape.experiments.significance:run",
        "faces": "semscape.experiments.faces:run",
    }
)


def chosen_experiments(name: str) -> tuple[str, ...]:
    """Return the experiments that a name stands for.

    Raises
    ------
    BadInputError
        For a name that is not known; the message names the nearest one.

    Examples
    --------
    >>> chosen_experiments("faces")
    ('faces',)
    """
    if name == ALL:
        return tuple(EXPERIMENTS)
    if name not in EXPERIMENTS:
        known = (*EXPERIMENTS, ALL)
        nearest = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise BadInputError(f"no experiment {name!r}; the nearest one is {nearest!r} (all: {', '.join(known)})")
    return (name,)


def run_experiments(
    name: str, setting: Setting, *, progress: Callable[[str], None] | None = None
) -> tuple[Experiment, ...]:
    """Run an experiment, or "all" of them in the order of the thesis.

    Parameters
    ----------
    name : str
        A key of `EXPERIMENTS`, or "all".
    setting : Setting
    progress : callable, optional
        Called with a line when an experiment starts or fails.

    Raises
    ------
    BadInputError
        For an unknown name or a folder of data that is not there.
    SemscapeError
        If the one experiment that was asked for fails; among all, a failure is a note on the page.
    """
    chosen = chosen_experiments(name)
    if setting.data is not None and not setting.data.is_dir():
        raise BadInputError(
            f"the folder of measured sets {setting.data} does not exist; leave --data out to do without"
        )
    report = progress or (lambda _: None)
    done = []
    for number, key in enumerate(chosen, start=1):
        report(f"{key} ({number} of {len(chosen)})")
        module, function = EXPERIMENTS[key].split(":")
        run: Callable[[Setting], Experiment] = getattr(import_module(module), function)
        try:
            done.append(run(setting))
        except SemscapeError as error:
            if name != ALL:
                raise
            report(f"{key} failed: {error}")
            done.append(Experiment(key, key.capitalize(), "", "", (), notes=(f"failed: {error}",)))
    return tuple(done)
