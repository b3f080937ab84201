"""Images of 4D scenes through lenses that a rasterizer does not have, by tracing rays: fisheye lenses, panoramas and
depth of field, with mirrors and glass balls in the scene. Only ``gpu_picture`` needs
torch."""
