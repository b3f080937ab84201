"""The names of devices, in a module that does not import torch, so that help texts can list them quickly."""

from typing import Literal

DeviceName = Literal["auto", "cpu", "cuda"]
"""Device name. "auto" selects a GPU if fourd can use one, and the CPU otherwise."""
