"""The types in the comments of the web player, checked by the TypeScript compiler."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
WEB = ROOT / "viewer" / "web"


@pytest.fixture(scope="module")
def compiler() -> Path:
    """The TypeScript compiler of viewer/web/package.json, installed in build/typescript."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("no node and npm here")
    version = json.loads((WEB / "package.json").read_text())["devDependencies"]["typescript"]
    folder = ROOT / "build" / "typescript"
    found = folder / "node_modules" / "typescript"
    if not found.is_dir() or json.loads((found / "package.json").read_text())["version"] != version:
        folder.mkdir(parents=True, exist_ok=True)
        words = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund", f"typescript@{version}"]
        installed = subprocess.run(words, capture_output=True, text=True)
        if installed.returncode != 0:
            pytest.skip(f"npm cannot install TypeScript: {installed.stderr.strip()[-200:]}")
    return found / "bin" / "tsc"


def test_types_are_consistent(compiler: Path) -> None:
    """Catches a misspelt property, a missing null check, or a call with wrong arguments."""
    checked = subprocess.run(["node", str(compiler), "-p", str(WEB)], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout


def test_the_check_finds_errors(compiler: Path, tmp_path: Path) -> None:
    """Catches a configuration that checks no file."""
    shutil.copytree(WEB, tmp_path / "web")
    clock = tmp_path / "web" / "play" / "clock.js"
    clock.write_text(clock.read_text().replace("this.frames - 1", "this.frame_count - 1", 1))
    checked = subprocess.run(["node", str(compiler), "-p", str(tmp_path / "web")], capture_output=True, text=True)
    assert "frame_count" in checked.stdout
