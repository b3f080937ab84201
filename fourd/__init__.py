"""fourd: multi-view video of a moving scene in, a 4D point scene out.

Importing this package loads nothing native and no torch; each package loads what
it needs when it is imported itself.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("fourd")
except PackageNotFoundError:  # sources on the path, not installed
    __version__ = "0+unknown"
