"""Locks on folders, deferral of Ctrl-C, and child processes for parsers that can crash."""

from fourd.processes.interrupts import DeferredInterrupt
from fourd.processes.locks import locked_file, locked_folder

__all__ = ["DeferredInterrupt", "locked_file", "locked_folder"]
