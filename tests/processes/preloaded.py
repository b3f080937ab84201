"""The import of this module imports what the commands of fourd import when they need it. Processes that fork for each
command import it first. They have one thread, so that forking is safe.
"""

from __future__ import annotations

import importlib
import pkgutil
from contextlib import suppress
from pathlib import Path

import cv2
import torch
from PIL import Image

import fourd
from fourd.rendering.ops.loading import load_native

PACKAGES = ("base", "recording", "reconstruction", "rendering", "scene", "pipeline", "cli")
"""Packages of fourd that the commands use. Commands import most modules when they need them."""
LIBRARIES = ("torch.utils.tensorboard", "networkx", "trimesh", "typeguard", "tyro._backends._tyro_backend")
"""Modules that fourd or its libraries import in functions."""


def _import_modules() -> None:
    folder = Path(fourd.__file__).parent
    for package in PACKAGES:
        for module in pkgutil.walk_packages([str(folder / package)], f"fourd.{package}."):
            with suppress(ImportError):  # modules for NVIDIA's libraries, or for a package that is not installed
                importlib.import_module(module.name)
    for library in LIBRARIES:
        importlib.import_module(library)


def _use_libraries() -> None:
    """Use what imports further modules at its first use."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    Image.init()
    load_native()
    weight = torch.zeros(1, requires_grad=True)
    optimizer = torch.optim.Adam([weight])
    weight.sum().backward()
    optimizer.step()


_import_modules()
_use_libraries()
