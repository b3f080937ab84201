"""The images of a training step (``csrc/step_images``)."""
