"""``python -m fourd.viewer.blender [ADDON.zip]`` writes the add-on as a ZIP file that Blender installs."""

from __future__ import annotations

import sys
from pathlib import Path

from fourd.viewer.blender.archive import write_addon


def main(words: list[str]) -> int:
    """Write the file, and print its name."""
    if len(words) > 1 or (words and words[0].startswith("-")):
        print("usage: python -m fourd.viewer.blender [ADDON.zip]", file=sys.stderr)
        return 2
    out = Path(words[0] if words else "fourd_blender.zip")
    try:
        write_addon(out)
    except OSError as error:
        print(f"{out}: cannot be written ({error.strerror or error}); use another folder", file=sys.stderr)
        return 2
    print(f"wrote {out}; in Blender: Edit > Preferences > Add-ons > Install from Disk")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
