"""Packages from npm that the tests of the web player need."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
WEB = ROOT / "viewer" / "web"
TIMEOUT_SECONDS = 120


def require_npm() -> None:
    """Skip the test if node or npm is missing."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("no node and npm here")


def installed(name: str) -> Path:
    """The folder of a package of viewer/web/package.json. The first call installs all packages of this file in
    build/npm.

    Skips the test if npm fails or takes longer than ``TIMEOUT_SECONDS``. A process that has failed once does not try
    again, because each attempt can take until the time limit.
    """
    require_npm()
    versions = json.loads((WEB / "package.json").read_text())["devDependencies"]
    folder = ROOT / "build" / "npm"
    if not all(_has(folder, package, version) for package, version in versions.items()):
        reason = _failure(folder, tuple(f"{package}@{version}" for package, version in versions.items()))
        if reason:
            pytest.skip(reason)
    return folder / "node_modules" / name


def _has(folder: Path, name: str, version: str) -> bool:
    manifest = folder / "node_modules" / name / "package.json"
    return manifest.is_file() and json.loads(manifest.read_text())["version"] == version


@cache
def _failure(folder: Path, packages: tuple[str, ...]) -> str:
    """Install the packages. Returns why this failed, or an empty string if they are installed."""
    folder.mkdir(parents=True, exist_ok=True)
    words = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", "--prefer-offline"]
    try:
        done = subprocess.run(
            [*words, "--fetch-retries", "1", *packages], capture_output=True, text=True, timeout=TIMEOUT_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"npm did not install {', '.join(packages)} in {TIMEOUT_SECONDS} seconds"
    return "" if done.returncode == 0 else f"npm cannot install {', '.join(packages)}: {done.stderr.strip()[-200:]}"
