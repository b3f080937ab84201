// The scratch memory of a compositor on a GPU.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fourd::tiles::cuda {

// Scratch memory with space for a limited number of entries, which are (primitive, tile) pairs. If an image needs more
// entries, every pixel tests every primitive, which is slow but gives the same image. For each image, the GPU counts
// the required entries and writes their number to `needed`, so that the caller can allocate enough memory for later
// images. The caller does not wait for this number before it renders the current image, because waiting would stall the
// CPU.
struct EntryBuffer {
    void* memory;           // At least workspace_bytes() bytes.
    std::size_t entries;    // Below 2^31.
    std::uint64_t* needed;  // The count that the GPU writes: one integer in page-locked host memory or in GPU memory.
};

}  // namespace fourd::tiles::cuda
