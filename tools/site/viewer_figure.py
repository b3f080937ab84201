"""Make docs/figures/viewer.png, a screenshot of the viewer with the scene of `make demo` on a virtual screen.

    python tools/site/viewer_figure.py [SCENE] [PNG]

The program needs Xvfb, xdotool and python-xlib.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from PIL import Image  # noqa: E402

from tests.viewer.screen import Viewer, screen  # noqa: E402

SIZE = (1280, 760)
BACKGROUND = ("0.12", "0.14", "0.17")
WARM_UP_SECONDS = 8.0
"""Seconds to wait before the screenshot, until the timing plot is full."""


def main(scene: str = "demo/scene.4dv", out: str = "docs/figures/viewer.png") -> None:
    """Write docs/figures/viewer.png."""
    size = [str(side) for side in SIZE]
    words = [str((ROOT / scene).resolve()), "--size", *size, "--background", *BACKGROUND]
    with tempfile.TemporaryDirectory() as folder, screen(*SIZE) as display:
        viewer = Viewer(display, Path(folder), *words)
        time.sleep(WARM_UP_SECONDS)
        image = viewer.picture()
        viewer.close()
    Image.fromarray(image).save(ROOT / out)


if __name__ == "__main__":
    main(*sys.argv[1:])
