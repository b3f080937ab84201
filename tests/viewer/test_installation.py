"""What an editable installation adds to the interpreter, and that it finds the viewer."""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import json, sys
from importlib.resources import files
import fourd.viewer.state
print(json.dumps([sys.path, fourd.viewer.state.__file__, str(files("fourd.viewer") / "shaders")]))
"""


def test_an_editable_installation_adds_no_folder_above_the_checkout(tmp_path: Path) -> None:
    """Catches the checkout's parent folder on ``sys.path``, where every neighbouring folder can be imported, and
    shaders that are read from a copy of the checkout."""
    if not Path(sysconfig.get_path("purelib"), "_editable_skbc_fourd.py").exists():
        pytest.skip("fourd is not installed as an editable package")
    command = [sys.executable, "-P", "-c", PROGRAM]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    folders, module, shaders = json.loads(done.stdout)
    assert not {str(folder) for folder in ROOT.parents} & set(folders)
    assert Path(module) == ROOT / "viewer" / "state.py"
    assert Path(shaders) == ROOT / "viewer" / "shaders"
