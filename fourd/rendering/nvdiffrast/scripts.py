"""Runs scripts that were written for nvdiffrast: ``python -m fourd.rendering.nvdiffrast SCRIPT``."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType

import torch

import fourd.rendering.nvdiffrast as operations
from fourd.base.errors import UserError
from fourd.rendering.nvdiffrast.redirection import run_on_cpu

USAGE = """usage: python -m fourd.rendering.nvdiffrast [--cpu] SCRIPT [ARGUMENT ...]

Run a script that was written for nvdiffrast, unchanged. `import nvdiffrast.torch` gives fourd.rendering.nvdiffrast.
Without a CUDA device, or with --cpu, calls that use one run on the CPU; the first call of each kind is printed."""


def run_script(arguments: Sequence[str]) -> None:
    """Run a script as ``python SCRIPT`` would.

    Args:
        arguments: an optional "--cpu", the script's path, and its arguments.

    Raises:
        UserError: if the script is not a file. Errors of the script itself are not caught.
    """
    on_cpu = not torch.cuda.is_available()
    if arguments and arguments[0] == "--cpu":
        on_cpu, arguments = True, arguments[1:]
    if not arguments or not Path(arguments[0]).is_file():
        found = arguments[0] if arguments else "no argument"
        raise UserError(f"SCRIPT: expected a Python file, got {found}; see python -m fourd.rendering.nvdiffrast --help")
    script = str(arguments[0])
    with _arguments([script, *arguments[1:]]), _as_nvdiffrast(), run_on_cpu() if on_cpu else nullcontext():
        runpy.run_path(script, run_name="__main__")


@contextmanager
def _arguments(argv: list[str]) -> Iterator[None]:
    """Set ``sys.argv``, and the folder of the script as the first folder of ``sys.path``, as Python does."""
    before, path = sys.argv, sys.path[:]
    sys.argv = argv
    sys.path[0] = str(Path(argv[0]).resolve().parent)
    try:
        yield
    finally:
        sys.argv, sys.path[:] = before, path


@contextmanager
def _as_nvdiffrast() -> Iterator[None]:
    """Make ``import nvdiffrast.torch`` give :mod:`fourd.rendering.nvdiffrast`."""
    package = ModuleType("nvdiffrast", "Stands for nvdiffrast; its module torch is fourd.rendering.nvdiffrast.")
    package.__path__ = []
    package.__dict__.update(torch=operations, __version__="fourd")
    replaced: dict[str, ModuleType] = {"nvdiffrast": package, "nvdiffrast.torch": operations}
    before = {name: sys.modules.get(name) for name in replaced}
    sys.modules.update(replaced)
    print("fourd: import nvdiffrast.torch gives fourd.rendering.nvdiffrast", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
