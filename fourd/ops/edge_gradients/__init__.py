"""Gradients at visibility edges that do not change the image, in plain torch."""
