"""Importers: what others write, read into this project's conventions."""
