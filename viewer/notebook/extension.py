"""``%load_ext fourd``: notebooks then show scenes and runs as players when they are the value of a cell."""

from __future__ import annotations

from typing import Any

from fourd.viewer.notebook.show import show

SHOWN = (
    ("fourd.scene.rendering", "Scene"),
    ("fourd.reconstruction.training.run", "Run"),
    ("fourd.reconstruction.training.run", "TrainedRun"),
    ("fourd.reconstruction.training.segments.segmented_run", "SegmentedRun"),
)
"""Module and name of each class whose objects are shown. They are named so that torch is not imported for them."""


def load_ipython_extension(shell: Any) -> None:
    """Called by IPython for ``%load_ext fourd``."""
    for module, name in SHOWN:
        shell.display_formatter.mimebundle_formatter.for_type_by_name(module, name, _describe)


def unload_ipython_extension(shell: Any) -> None:
    """Called by IPython for ``%unload_ext fourd``."""
    formatter = shell.display_formatter.mimebundle_formatter
    for module, name in SHOWN:
        formatter.deferred_printers.pop((module, name), None)
        for kind in [each for each in formatter.type_printers if (each.__module__, each.__name__) == (module, name)]:
            formatter.pop(kind)


def _describe(value: Any, include: Any = None, exclude: Any = None) -> Any:
    """Return the player of a scene or a run, in the formats that IPython chooses from."""
    return show(value)._repr_mimebundle_()
