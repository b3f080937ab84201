"""The sources use plain technical English, without phrases that readers from the field would have to look up.

Each entry of PHRASES pairs a phrase with its replacement. Add a phrase when a reader does not understand it.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("fourd", "viewer", "csrc", "docs", "tools", "configs", "examples")
SOURCES = {".py", ".h", ".inc", ".cpp", ".cu", ".cuh", ".glsl", ".vert", ".frag", ".js"}
SUFFIXES = SOURCES | {".md", ".yaml", ".sh", ".cmake", ".mk"}
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile")

PHRASES = {
    r"\bmend(s|ed|ing)?\b": "fix",
    r"\b(go|goes|gone|going|went) on (with|where|when|by|after)\b|\bgone on\b|\bgoes on\b": "resume, continue",
    r"\bbegun\b": "started",
    r"\bwhat(ever)? moves\b": "dynamic part, foreground",
    r"\btold (by|from|of|apart)\b|\b(is|are|be) told\b": "from, given, reported, distinguished",
    r"\bdear(er|est|ly)?\b": "expensive",
    r"\bin such company\b": "state the load",
    r"\b(on a )?calm day\b|\bslow day\b": "state the load of the machine",
    r"\blight is left\b|\blight that is left\b": "transmittance",
    r"\bnone in value\b": "identity",
    r"\b(no|a|any|its|their|the|some) say\b": "blend weight, visibility weight, log",
    r"\b(is|are) no numbers?\b|\bno number\b": "NaN",
    r"\bpull(s|ed)? (hard|hardest|most)\b": "gradient magnitude",
    r"\btrust (of|in|falls|is|at)\b|\b(is|are) trusted\b": "visibility weight, confidence",
    r"\bframes kept out\b|\bkept out of the fit\b": "held-out frames",
    r"\bmore perpendicular than parallel\b|\bmore parallel than perpendicular\b": "name the angle",
    r"\bdifferentiable once\b": "differentiable; second derivatives are not supported",
    r"\blately\b|\bof late\b": "leave it out",
    r"\bastray\b": "wrong, outlier",
    r"\bat fault\b": "wrong, invalid",
    r"\bat hand\b": "available",
    r"\bas far as\b": "to the extent that, up to",
    r"\bso many\b(?! that)": "a number, N",
    r"\balike\b": "equal, similar, both",
    r"\banew\b": "again",
    r"\b(nought|aught|thereof|wherein|whither|thence|ere|amidst|twain|whence)\b": "modern words",
    r"\bado\b": "leave it out",
    r"\bhow sure\b|\bso sure\b": "confidence",
    r"\bswept\b": "motion extent",
    r"\bgauged\b|\bgauging\b": "scale",
    r"\bvantage\b": "viewpoint",
    r"\bhas its way\b|\bcomes of\b|\bwhat of (a|the)\b": "name the thing",
    r"\bis not to be\b|\bare not to be\b": "must not be, is not",
    r"\bholds good\b|\bmakes do\b": "is valid",
}


@cache
def texts() -> dict[str, str]:
    """The text of every file that is checked for phrases, by its path."""
    found = [ROOT / name for name in PAGES]
    for folder in FOLDERS:
        found += [path for path in sorted((ROOT / folder).rglob("*")) if path.suffix in SUFFIXES and path.is_file()]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in found}


def occurrences(pattern: str) -> list[str]:
    """Every occurrence of a phrase as ``file:line: text``."""
    phrase = re.compile(pattern, re.IGNORECASE)
    found = []
    for path, text in texts().items():
        for match in phrase.finditer(text):
            row = text.count("\n", 0, match.start()) + 1
            found.append(f"{path}:{row}: {text.splitlines()[row - 1].strip()}")
    return found


@pytest.mark.parametrize("pattern", PHRASES)
def test_plain_words(pattern: str) -> None:
    """Catches a phrase that readers from the field would have to look up."""
    found = occurrences(pattern)
    assert not found, f"write '{PHRASES[pattern]}' instead:\n" + "\n".join(found)
