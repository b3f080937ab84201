"""Ray-traced images of 4D scenes through lenses that a rasterizer cannot draw: fisheye lenses, panoramas and depth of
field. The scene can contain mirrors and glass balls. Only ``gpu_picture`` needs torch."""
