"""The names of the renderers, in a module without dependencies, so that help texts can list them quickly."""

from typing import Literal

RendererName = Literal["sorted", "peel", "dual", "cpu"]
