// Predicts the count of entries of an image from the counts of earlier images. The image is divided into tiles, and a
// tile has one entry for each primitive that covers it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace fourd::device {

// Allocates a 64-bit integer in host memory that the GPU can write. Throws std::runtime_error if the allocation fails.
std::uint64_t* allocate_mapped_counter();
void free_mapped_counter(std::uint64_t* number);

// Predicts the count of entries of the next image. Each device has one estimator, which exists until the process ends.
// The prediction never waits for the GPU, because it uses the last count that the GPU has already written.
class EntryEstimator {
  public:
    EntryEstimator() : needed_(allocate_mapped_counter()) { *needed_ = 0; }
    ~EntryEstimator() { free_mapped_counter(needed_); }
    EntryEstimator(const EntryEstimator&) = delete;
    EntryEstimator& operator=(const EntryEstimator&) = delete;

    // Returns the number of entries to allocate for the next image, which has `count` primitives. The number is 25%
    // above the recent maximum count of entries. This maximum decays slowly, so that the allocation stays large enough
    // if near and far views of a scene alternate. Before the GPU has written a count, the number is
    // kFirstGuess * count. The result is rounded up (see kStep) and at most kMaxEntries.
    std::size_t entries(std::size_t count) {
        const std::uint64_t needed = *static_cast<volatile std::uint64_t*>(needed_);
        recent_max_ = std::max(recent_max_ - recent_max_ / 64, needed);
        const std::uint64_t estimate =
            recent_max_ > 0 ? recent_max_ + recent_max_ / 4 : kFirstGuess * std::uint64_t{count};
        const std::uint64_t rounded = (estimate / kStep + 1) * kStep;
        return static_cast<std::size_t>(std::min(rounded, kMaxEntries));
    }

    std::uint64_t* needed() const { return needed_; }

  private:
    static constexpr std::uint64_t kFirstGuess = 8;
    // The number of entries is rounded up to the next larger multiple of kStep, so that consecutive images can reuse
    // the same memory.
    static constexpr std::uint64_t kStep = 1 << 16;
    static constexpr std::uint64_t kMaxEntries = 0x7fff0000;

    std::uint64_t* needed_;
    std::uint64_t recent_max_ = 0;
};

}  // namespace fourd::device
