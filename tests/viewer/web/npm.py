"""Packages from npm that the tests of the web player need."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
WEB = ROOT / "viewer" / "web"


def installed(name: str) -> Path:
    """The folder of a package of viewer/web/package.json, installed in build/npm. Skips the test if npm fails."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("no node and npm here")
    version = json.loads((WEB / "package.json").read_text())["devDependencies"][name]
    folder = ROOT / "build" / "npm" / name
    found = folder / "node_modules" / name
    if not found.is_dir() or json.loads((found / "package.json").read_text())["version"] != version:
        folder.mkdir(parents=True, exist_ok=True)
        words = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", f"{name}@{version}"]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode != 0:
            pytest.skip(f"npm cannot install {name}: {done.stderr.strip()[-200:]}")
    return found
