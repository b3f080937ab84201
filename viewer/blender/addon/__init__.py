"""fourd scenes: imports 4D point scenes into Blender."""

bl_info = {
    "name": "fourd scenes",
    "author": "The fourd developers",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "File > Import > fourd scene (.4dv, .ply)",
    "description": "Import 4D point scenes, sequences of PLY files and their cameras",
    "category": "Import-Export",
}


def register() -> None:
    """Called by Blender when the add-on is switched on."""
    from fourd.viewer.blender.addon import frames, operators

    operators.register()
    frames.register()


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
    from fourd.viewer.blender.addon import frames, operators

    frames.unregister()
    operators.unregister()
