"""The entry point ``fourd``: picks the command, and turns errors into one line and an exit code."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence

from rich.console import Console

from fourd.cli.usage import one_line_of_usage
from fourd.errors import UserError

COMMANDS = {
    "make": "runs.make",
    "import": "captures.import_",
    "synth": "captures.synth",
    "check": "captures.check",
    "matte": "captures.matte",
    "carve": "captures.carve",
    "train": "runs.train",
    "eval": "runs.eval",
    "export": "runs.export",
    "render": "scenes.render",
    "view": "scenes.view",
    "bench": "scenes.bench",
    "info": "scenes.info",
}
"""Each command's module below :mod:`fourd.cli`."""

USERS_DISK = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EEXIST,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENAMETOOLONG,
)
"""What the system refuses for reasons that the user can mend and our code cannot."""

TRAINING_PACKAGES = ("h5py", "pycolmap", "safetensors", "tensorboard", "torch")
"""What the extra ``fourd[train]`` adds; playing a scene needs none of it."""

HELP = """fourd: multi-view video of a moving scene in, a 4D point scene out.

  fourd make CAPTURE -o scene.4dv   everything below, cached and resumable
  fourd import [FORMAT] SRC OUT     another program's calibration and videos, as a capture
  fourd synth OUT                   a synthetic capture with truth
  fourd check CAPTURE               what is there, what is wrong
  fourd matte CAPTURE               make mattes and clean plates
  fourd carve CAPTURE               points of each frame, bounds
  fourd train CAPTURE --out RUN     train a model
  fourd eval RUN                    quality on held-out views
  fourd export RUN -o scene.4dv     bake for real-time rendering
  fourd render RUN|SCENE --out OUT  pictures or a video
  fourd view SCENE|RUN              walk around in it while it plays
  fourd bench                       speed of kernels and stages on this machine
  fourd info FILE|DIR               what a file or folder is

fourd COMMAND --help tells each command's options and their units.
Exit codes: 0 done; 2 the input is wrong; 1 our fault.
"""


SPINS = "20000"
"""How often torch's idle threads look for work before they sleep: by default for so long that our own threads, which
take turns with them on the same cores, wait for them. A training step takes 6 to 12% less."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # Read by GNU's OpenMP when torch is loaded, which commands do.
    os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    if not words or words[0] in ("-h", "--help"):
        print(HELP, end="")
        return 0
    if words[0] == "--version":
        from fourd import __version__

        print(f"fourd {__version__}")
        return 0
    try:
        return _run(words[0], words[1:])
    except UserError as error:
        print(f"fourd {words[0]}: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package not in TRAINING_PACKAGES:
            raise
        missing = f"needs the training packages, of which {package} is missing; pip install 'fourd[train]'"
        print(f"fourd {words[0]}: {missing}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.errno not in USERS_DISK:
            raise
        reason = (error.strerror or "").lower()
        got = f"expected to read and write there, got '{reason}'; make room or name another place"
        print(f"fourd {words[0]}: {error.filename or 'the disk'}: {got}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        Console(stderr=True).print(f"fourd {words[0]}: stopped; what was finished is kept")
        return 130


def _run(command: str, words: list[str]) -> int:
    """Import the one command that is asked for, so that ``fourd info`` does not wait for torch."""
    import difflib
    import importlib

    import tyro

    if command not in COMMANDS:
        near = difflib.get_close_matches(command, COMMANDS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "see fourd --help"
        raise UserError(f"expected a command among {', '.join(COMMANDS)}, got '{command}'; {hint}")
    module = importlib.import_module(f"fourd.cli.{COMMANDS[command]}")
    with one_line_of_usage():
        arguments = tyro.cli(
            module.Arguments,
            prog=f"fourd {command}",
            args=words,
            description=module.__doc__,
            config=(tyro.conf.OmitArgPrefixes,),
        )
    code = module.run(arguments)
    return 0 if code is None else int(code)


if __name__ == "__main__":
    sys.exit(main())
