"""What an editable installation adds to the interpreter, and that it and wheels have the viewer once."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import json, sys
from importlib.resources import files
from importlib.util import find_spec
import fourd.viewer.state
shaders = str(files("fourd.viewer") / "shaders")
print(json.dumps([sys.path, fourd.viewer.state.__file__, shaders, find_spec("fourd.tests") is None]))
"""
BUILD = "import scikit_build_core.build as build, sys; build.build_wheel(sys.argv[1], {'wheel.cmake': 'false'})"
NOT_PACKED = ("examples", "node_modules", "package-lock.json", "__pycache__")


def test_an_editable_installation_adds_no_folder_above_the_checkout(tmp_path: Path) -> None:
    """Catches the checkout's parent folder on ``sys.path``, where every neighbouring folder can be imported, the
    checkout's root among the folders of the package fourd, and shaders that are read from a copy of the checkout."""
    if not Path(sysconfig.get_path("purelib"), "_editable_skbc_fourd.py").exists():
        pytest.skip("fourd is not installed as an editable package")
    command = [sys.executable, "-P", "-c", PROGRAM]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    folders, module, shaders, has_no_tests = json.loads(done.stdout)
    assert not {str(folder) for folder in ROOT.parents} & set(folders)
    assert has_no_tests
    assert Path(module).resolve() == ROOT / "viewer" / "state.py"
    assert Path(shaders).resolve() == ROOT / "viewer" / "shaders"


@pytest.mark.parametrize("has_links", [True, False])
def test_a_wheel_has_the_viewer_once(has_links: bool, tmp_path: Path) -> None:
    """Catches a wheel with a second copy of the viewer or without its shaders and pages. Also catches a wheel that
    cannot be built where git writes the link fourd/viewer as a text file."""
    pytest.importorskip("scikit_build_core", reason="scikit-build-core is not installed")
    source = tmp_path / "source"
    for folder in ("fourd", "viewer"):
        ignored = shutil.ignore_patterns("__pycache__", "node_modules")
        shutil.copytree(ROOT / folder, source / folder, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, source / name)
    link = source / "fourd" / "viewer"
    assert os.readlink(link) == "../viewer"
    if not has_links:
        link.unlink()
        link.write_text("../viewer")
    subprocess.run([sys.executable, "-c", BUILD, tmp_path], cwd=source, capture_output=True, check=True)
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        packed = [name for name in wheel.namelist() if "viewer/" in name]
    viewer = [path.relative_to(ROOT) for path in (ROOT / "viewer").rglob("*") if path.is_file()]
    wanted = [f"fourd/{path.as_posix()}" for path in viewer if not set(NOT_PACKED) & set(path.parts)]
    assert sorted(packed) == sorted(wanted)
