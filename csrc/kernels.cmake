# Each call adds a kernel. docs/guides/adding_a_kernel.md explains how to add one.
fourd_kernel(antialias
  CPU cpu/antialias.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 EXACT
  CUDA cuda/antialias.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(blend
  CPU cpu/blend.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 TOLERANT
  BINDING binding.cpp)

fourd_kernel(edge_gradients
  CPU cpu/edge_gradients.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 EXACT
  CUDA cuda/edge_gradients.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(encoder
  CPU cpu/backward.cpp cpu/forward.cpp cpu/weight_sums.cpp cpu/weights.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 TOLERANT
  CUDA cuda/encoder.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(hashgrid
  CPU cpu/encode.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 TOLERANT
  CUDA cuda/encode.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(heads
  CPU cpu/heads.cpp cpu/lines.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 TOLERANT
  BINDING binding.cpp)

fourd_kernel(interpolate
  CPU cpu/interpolate.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 EXACT
  CUDA cuda/interpolate.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(meshes
  CPU tile_slots.cpp)

fourd_kernel(moves
  CPU moves.cpp
  BINDING binding.cpp)

fourd_kernel(pixel_filter
  CPU cpu/pixel_filter.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 EXACT
  CUDA cuda/pixel_filter.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(planes
  CPU cpu/sample.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 TOLERANT
  CUDA cuda/sample.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(play
  CPU player.cpp
  CUDA cuda/draw.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(points
  CPU cpu/render.cpp
  DISPATCH cpu/tiles.cpp WIDEST avx512 EXACT
  CUDA cuda/render.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(rasterize
  CPU cpu/bins.cpp cpu/rasterize.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 EXACT
  CUDA cuda/rasterize.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(rays
  CPU cpu/bounds.cpp cpu/discs.cpp cpu/topology.cpp cpu/trace.cpp cpu/triangles.cpp
  DISPATCH cpu/disc_loops.cpp cpu/loops.cpp WIDEST avx2 EXACT
  CUDA cuda/discs.cu cuda/trace.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(shade
  CPU cpu/shade.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 TOLERANT
  BINDING binding.cpp)

fourd_kernel(similarity
  CPU cpu/similarity.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 TOLERANT
  BINDING binding.cpp)

fourd_kernel(soft_triangles
  CPU cpu/render.cpp
  DISPATCH cpu/tiles.cpp WIDEST avx512 EXACT
  CUDA cuda/render.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(sources
  CPU cpu/sample.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 TOLERANT
  CUDA cuda/sample.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(splat_triangles
  CPU cpu/render.cpp
  DISPATCH cpu/tiles.cpp WIDEST avx512 EXACT
  CUDA cuda/render.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(step_images
  CPU cpu/step_images.cpp
  DISPATCH cpu/loops.cpp WIDEST avx2 EXACT
  BINDING binding.cpp)

fourd_kernel(stylize
  CPU cpu/stylize.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 TOLERANT
  BINDING binding.cpp)

fourd_kernel(texture
  CPU cpu/backward.cpp cpu/sample.cpp
  DISPATCH cpu/loops.cpp WIDEST avx512 TOLERANT
  CUDA cuda/sample.cu
  BINDING binding.cpp
  CUDA_BINDING cuda/binding.cpp)

fourd_kernel(unpack
  CPU positions.cpp
  DISPATCH loops.cpp WIDEST avx2 TOLERANT
  BINDING binding.cpp)
