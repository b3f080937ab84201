"""Ids, constants and argument checks that the operators for triangles share."""
