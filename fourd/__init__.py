"""fourd: multi-view video of a moving scene in, a 4D point scene out.

Importing this package loads neither native modules nor torch. Each subpackage loads its own dependencies when the
subpackage is imported.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("fourd")
except PackageNotFoundError:  # imported from a source folder without installation
    __version__ = "0+unknown"
