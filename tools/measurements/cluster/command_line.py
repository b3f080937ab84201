"""Parses the command lines of the programs in this folder, which pass the words after ``--`` to fourd."""

from __future__ import annotations

import argparse
import sys


def parse_with_options(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse the words before ``--``. The words after ``--`` become the tuple ``options``."""
    words = sys.argv[1:]
    own = words[: words.index("--")] if "--" in words else words
    arguments = parser.parse_args(own)
    arguments.options = tuple(words[len(own) + 1 :])
    return arguments
