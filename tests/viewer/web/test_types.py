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


def test_types_are_consistent(compiler: Path, tmp_path: Path) -> None:
    """Catches a misspelt property, a missing null check, and a configuration that checks no file."""
    shutil.copytree(WEB, tmp_path / "web")
    wrong = "import { Clock } from './clock.js';\nexport const frames = new Clock(1, 30).frame_count;\n"
    (tmp_path / "web" / "play" / "wrong.js").write_text(wrong)
    checked = subprocess.run(["node", str(compiler), "-p", str(tmp_path / "web")], capture_output=True, text=True)
    errors = checked.stdout.splitlines()
    assert len(errors) == 1, checked.stdout
    assert "wrong.js(2," in errors[0]
    assert "frame_count" in errors[0]
