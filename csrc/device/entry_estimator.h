// Predicts the number of entries of an image from earlier images. An entry is one (point, tile) pair.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace fourd::device {

// A number in host memory that the GPU can write. Throws std::runtime_error if it cannot be allocated.
std::uint64_t* allocate_mapped_counter();
void free_mapped_counter(std::uint64_t* number);

// There is one estimator per device, for the life of the process. It never waits for the GPU. A prediction uses the
// last number that the GPU has written by then.
class EntryEstimator {
  public:
    EntryEstimator() : needed_(allocate_mapped_counter()) { *needed_ = 0; }
    ~EntryEstimator() { free_mapped_counter(needed_); }
    EntryEstimator(const EntryEstimator&) = delete;
    EntryEstimator& operator=(const EntryEstimator&) = delete;

    // The number of entries to allocate for the next image, which has count points. It is 25% above the recent maximum.
    // The maximum decays slowly, because near and far views of a scene may alternate.
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
    static constexpr std::uint64_t kStep = 1 << 16;  // rounds up, so that consecutive images can reuse the same memory
    static constexpr std::uint64_t kMaxEntries = 0x7fff0000;

    std::uint64_t* needed_;
    std::uint64_t recent_max_ = 0;
};

}  // namespace fourd::device
