"""``python -m fourd.rendering.nvdiffrast SCRIPT``: see :mod:`fourd.rendering.nvdiffrast.scripts`."""

from __future__ import annotations

import sys

from fourd.base.errors import UserError
from fourd.rendering.nvdiffrast.scripts import USAGE, run_script


def main(arguments: list[str]) -> int:
    """Run a script and return the exit code, 2 if there is no such script."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(USAGE)
        return 0
    try:
        run_script(arguments)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
