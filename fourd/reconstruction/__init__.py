"""From a capture to a trained model: hulls, background, training, meshes."""
