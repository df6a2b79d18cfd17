"""Checks of a page that several tests make."""

from __future__ import annotations

from typing import Any

_SERIOUS = {"serious", "critical"}


def serious_faults(page: Any, axe_script: str) -> list[str]:
    """Return what axe finds of serious faults in a page: rule, and the first elements that break it."""
    page.evaluate(axe_script)  # a page's policy forbids another script element
    found = page.evaluate("async () => (await axe.run(document, {resultTypes: ['violations']})).violations")
    return [
        f"{fault['id']}: {[node['html'][:160] for node in fault['nodes'][:3]]}"
        for fault in found
        if fault["impact"] in _SERIOUS
    ]
