// Inner loops over the pixels of one picture, compiled once for each instruction set.
#pragma once

#include <cstdint>

#include "common/dispatch.h"
#include "texture/texture.h"

namespace fourd::texture {

constexpr int kTaskBits = 14;
constexpr std::size_t kTaskPixels = std::size_t{1} << kTaskBits;

// A range of at most kTaskPixels pixels of one picture.
struct Task {
    std::size_t picture;
    std::size_t begin;
    int count;
};

// The texels of one item (texture), divided into bands of consecutive texels. Each band belongs to one level.
struct Bands {
    int first[kMaxLevels];  // Index of the first band of a level.
    int shift[kMaxLevels];  // A band of the level has 2^shift texels.
    int count;
};

// An entry records that a pixel of a task (range of pixels) reads texels of a band (range of texels). Its value is
// 2 * i + s, where i is the index of the pixel in the task. A lookup blends up to two mip levels: s is 0 for texels of
// the finer level, and 1 for texels of the coarser level.
using Entry = std::uint16_t;
// Maximum number of entries of a task: four texels in each of two levels for each pixel.
constexpr std::size_t kMaxEntries = 8 * kTaskPixels;

struct EntryList {
    std::uint32_t* bands;  // Shape (kMaxEntries,): index of the band of each entry.
    Entry* entries;        // Shape (kMaxEntries,).
    std::size_t count;
};

// The sums of the gradients of the texels [begin, end) of a level. All of these texels belong to one band.
struct BandSums {
    int level;
    int begin, end;
    float* sums;  // Shape (end - begin, stride_of(channels)).
};

// Returns the number of floats per texel in BandSums. Three channels are padded to a vector of four.
FOURD_INLINE std::size_t stride_of(int channels) { return channels == 3 ? 4 : static_cast<std::size_t>(channels); }

struct Loops {
    void (*sample)(const Query&, const Task&, float* out);
    // Writes the gradients of uv, uv_da and bias. If `levels` (pictures, pixels) is not null, writes the clamped mip
    // level of each pixel. If `entries` is not null, lists the entries of the task. Pixels with a zero gradient have no
    // entries.
    void (*pixel_gradients)(const Query&, const Task&, const float* gradient, const Gradients& out, float* levels,
                            const Bands&, EntryList* entries);
    // Adds to the sums of a band the contributions of `count` entries (pixels that read texels of the band).
    void (*scatter)(const Query&, const Task&, const Entry* entries, std::size_t count, const float* gradient,
                    const float* levels, const BandSums&);
    // Computes some rows of a level from the next finer level. The finer level has two rows for each row of the coarser
    // level if halves_rows is true, and one row otherwise.
    void (*halve)(const float* fine, int fine_width, bool halves_rows, int channels, std::size_t rows, float* out);
    // The backward pass of halve: adds the gradient of the coarser level to some rows of the gradient of the finer
    // level.
    void (*halve_backward)(const float* coarse, int fine_width, bool halves_rows, int channels, std::size_t rows,
                           float* fine);
};

FOURD_DISPATCH(Loops, Simd::avx512)

}  // namespace fourd::texture
