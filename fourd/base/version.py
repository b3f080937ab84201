"""The version of the installed package."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("fourd")
except PackageNotFoundError:  # the package is used from a source folder, without installation
    __version__ = "0+unknown"
