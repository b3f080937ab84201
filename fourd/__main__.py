"""Runs the command line: ``python -m fourd`` and ``torchrun -m fourd``."""

from __future__ import annotations

import sys

from fourd.cli.main import console_main

if __name__ == "__main__":
    sys.exit(console_main())
