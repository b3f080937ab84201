"""Publishes scenes as web pages: writes a folder that any web server can serve, and serves it from this machine."""
