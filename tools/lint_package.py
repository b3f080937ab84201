"""Run mypy and import-linter on the package in its installed layout.

In the repository, the package fourd.viewer is in the folder viewer/, where mypy and import-linter do not find it. This
program therefore copies the Python files of fourd/ and viewer/ to build/lint/fourd, and runs both tools in build/lint.
`make lint` runs this program.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TREE = ROOT / "build" / "lint"


def main() -> int:
    copy_package()
    config = str(ROOT / "pyproject.toml")
    types = subprocess.run([sys.executable, "-m", "mypy", "--config-file", config], cwd=TREE)
    # The option -S skips the .pth file of the editable install, whose import hook would take precedence over
    # build/lint.
    lint_imports = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    options = ["--no-logo", "--config", config, "--cache-dir", str(TREE / ".import_linter_cache")]
    layers = subprocess.run(
        [sys.executable, "-S", "-c", lint_imports, *options],
        cwd=TREE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(TREE), sysconfig.get_path("purelib")])},
    )
    return types.returncode or layers.returncode


def copy_package() -> None:
    """Copy fourd/ and viewer/ to TREE. Modification times are kept, because mypy uses them to detect changes."""
    shutil.rmtree(TREE / "fourd", ignore_errors=True)
    shutil.copytree(ROOT / "fourd", TREE / "fourd", ignore=_not_python)
    shutil.copytree(ROOT / "viewer", TREE / "fourd" / "viewer", ignore=_not_python)


def _not_python(folder: str, names: list[str]) -> list[str]:
    """Return the entries of a folder that are not copied: non-Python files, caches, and the link fourd/viewer."""
    entries = (Path(folder) / name for name in names)
    return [
        entry.name
        for entry in entries
        if entry.is_symlink()
        or entry.name == "__pycache__"
        or (entry.is_file() and entry.suffix not in {".py", ".pyi", ".typed"})
    ]


if __name__ == "__main__":
    sys.exit(main())
