"""The types in the comments of the web player, checked by the TypeScript compiler."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from tests.viewer.web.npm import WEB, installed


def test_types_are_consistent(tmp_path: Path) -> None:
    """Catches a misspelt property, a missing null check, and a configuration that checks no file."""
    compiler = installed("typescript") / "bin" / "tsc"
    shutil.copytree(WEB, tmp_path / "web", ignore=shutil.ignore_patterns("node_modules"))
    wrong = "import { Clock } from './clock.js';\nexport const frames = new Clock(1, 30).frame_count;\n"
    (tmp_path / "web" / "play" / "wrong.js").write_text(wrong)
    checked = subprocess.run(["node", str(compiler), "-p", str(tmp_path / "web")], capture_output=True, text=True)
    errors = checked.stdout.splitlines()
    assert len(errors) == 1, checked.stdout
    assert "wrong.js(2," in errors[0]
    assert "frame_count" in errors[0]
