"""fourd turns multi-view video of a moving scene into a 4D point scene.

Importing this package loads neither native modules nor torch; each subpackage loads its own dependencies.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("fourd")
except PackageNotFoundError:  # the package is used from a source folder, without installation
    __version__ = "0+unknown"
