"""Scenes as web pages: the folder that any web server can serve, and a server for this machine."""
