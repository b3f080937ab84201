"""Stages that compute the first points of the foreground and the background."""
