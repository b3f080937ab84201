"""fourd turns multi-view video of a moving scene into a 4D point scene.

Importing this package loads neither native modules nor torch. The names in ``__all__`` are loaded at their first use:

- :func:`make` and :func:`train` run the pipeline, as the commands of the same names do, with the settings of a
  :class:`TrainConfig` and of :class:`MatteSettings`. :func:`open_run` opens a trained run.
- :func:`open_capture` reads the cameras, images and mattes of a capture.
- :func:`open_scene` reads a ``.4dv`` scene, and :class:`Player` draws its frames. Neither needs torch.
- :func:`show` plays a scene or a run in a notebook.
- :func:`orbit` and :func:`spiral` return camera paths around a scene or a capture.
- :func:`render_points` is the differentiable point renderer, for a :class:`Camera`, which :func:`look_at` or
  :meth:`Camera.from_fov` makes.
- :class:`UserError` is raised for an error that the user can cause.
"""

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.base.cameras import Camera, look_at
    from fourd.base.errors import UserError
    from fourd.base.version import __version__
    from fourd.pipeline.library import make, train
    from fourd.reconstruction.training.config import TrainConfig
    from fourd.reconstruction.training.run import open_run
    from fourd.recording.capture import open_capture
    from fourd.recording.matting.sequence import MatteSettings
    from fourd.rendering import render_points
    from fourd.scene import open_scene
    from fourd.scene.player import Player
    from fourd.viewer.navigation.paths import orbit, spiral
    from fourd.viewer.notebook.show import show

__all__ = [
    "Camera",
    "MatteSettings",
    "Player",
    "TrainConfig",
    "UserError",
    "__version__",
    "look_at",
    "make",
    "open_capture",
    "open_run",
    "open_scene",
    "orbit",
    "render_points",
    "show",
    "spiral",
    "train",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Camera": "base.cameras",
        "MatteSettings": "recording.matting.sequence",
        "Player": "scene.player",
        "TrainConfig": "reconstruction.training.config",
        "UserError": "base.errors",
        "__version__": "base.version",
        "load_ipython_extension": "viewer.notebook.extension",
        "look_at": "base.cameras",
        "make": "pipeline.library",
        "open_capture": "recording.capture",
        "open_run": "reconstruction.training.run",
        "open_scene": "scene",
        "orbit": "viewer.navigation.paths",
        "render_points": "rendering",
        "show": "viewer.notebook.show",
        "spiral": "viewer.navigation.paths",
        "train": "pipeline.library",
        "unload_ipython_extension": "viewer.notebook.extension",
    },
)
