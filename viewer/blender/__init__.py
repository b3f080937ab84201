"""An add-on for Blender that imports scenes, sequences of PLY files and cameras. Its sources are in addon/."""
