"""Loading of packages that takes seconds, which a terminal shows."""

from __future__ import annotations

import importlib
import sys


def load_package(name: str) -> None:
    """Import a package. If it is not imported yet and the errors go to a terminal, a line says so until it is, because
    the import of torch takes as long as some commands.

    Without a terminal, nothing is imported: the command imports the package when it needs it.
    """
    if name in sys.modules or not sys.stderr.isatty():
        return
    line = f"loading {name}"
    print(line, end="\r", file=sys.stderr, flush=True)
    try:
        importlib.import_module(name)
    finally:
        print(" " * len(line), end="\r", file=sys.stderr, flush=True)
