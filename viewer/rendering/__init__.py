"""The renderers, their common interface, and the automatic choice of a renderer."""
