"""Ids, constants and argument checks that all triangle operators share."""
