"""Draw the pictures that docs/index.md and docs/gallery.md show until their scene plays.

    .venv/bin/python tools/site/scene_pictures.py

Each picture shows frame 0 from the first camera, as the player does at first.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from fourd.base.files import atomic_path
from fourd.cli.main import main as fourd
from fourd.scene import open_scene

SCENES = Path(__file__).parents[2] / "docs" / "scenes"
SIDE = 480
"""Width and height of a picture in pixels."""
PICTURES = {"runner": None, "toon": "toon", "xtoon": "xtoon", "gooch": "gooch", "ink": "ink"}
"""The style of each picture."""


def draw(name: str, style: str | None) -> None:
    """Write docs/scenes/NAME.webp."""
    scene = SCENES / "runner.4dv"
    with open_scene(scene) as opened:
        view = opened.manifest.source_names[0] if opened.manifest.source_names else opened.manifest.other_names[0]
    with tempfile.TemporaryDirectory() as folder:
        words = ["render", str(scene), "--views", view, "--frames", "0:1", "--size", str(SIDE), str(SIDE), "-o", folder]
        words += ["--style", style] if style else []
        if fourd(words) != 0:
            sys.exit(f"{name}: fourd render failed")
        (drawn,) = Path(folder).rglob("*.png")
        with Image.open(drawn) as image, atomic_path(SCENES / f"{name}.webp") as temporary:
            image.convert("RGB").save(temporary, "WEBP", quality=85, method=6)


if __name__ == "__main__":
    for name, style in PICTURES.items():
        draw(name, style)
