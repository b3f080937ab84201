"""The formats of exported files, in a module without dependencies, so that help texts can list them quickly."""

from typing import Literal

Format = Literal["ply-sequence", "splat", "spz", "glb", "usd", "4dgs", "ply"]
