"""Facts about a capture that ``fourd info`` prints: its test split, and which cameras have masks."""

from __future__ import annotations

from pathlib import Path

from fourd.capture import Capture
from fourd.capture.split import read_test_views


def split_and_masks(path: Path, capture: Capture) -> list[tuple[str, str]]:
    """Return the titles and texts of the facts."""
    rows, split = [], read_test_views(path)
    if split is not None:
        rows.append(("test split", ", ".join(split) or "no cameras"))
    masked = [capture.names[index] for index in capture.masked]
    some = f"of {len(masked)} cameras, not of {', '.join(name for name in capture.names if name not in masked)}"
    rows.append(("masks", "yes" if capture.has_masks else some if masked else "none"))
    return rows
