"""Locks on folders, deferral of Ctrl-C, calls at intervals, and child processes for parsers that can crash."""

from fourd.base.processes.interrupts import DeferredInterrupt, ReceivedSignals, handle_termination
from fourd.base.processes.locks import locked_file, locked_folder
from fourd.base.processes.periodic import called_every

__all__ = ["DeferredInterrupt", "ReceivedSignals", "called_every", "handle_termination", "locked_file", "locked_folder"]
