// Predicts the number of (point, tile) entries of a picture from earlier pictures.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace fourd::device {

// A host counter that the GPU writes to. Throws std::runtime_error if it cannot be allocated.
std::uint64_t* allocate_mapped_counter();
void free_mapped_counter(std::uint64_t* number);

// One per device, for the life of the process. Nothing waits for the GPU: a picture's number of entries is used by the
// pictures that start after the GPU has written it.
class EntryEstimator {
  public:
    EntryEstimator() : needed_(allocate_mapped_counter()) { *needed_ = 0; }
    ~EntryEstimator() { free_mapped_counter(needed_); }
    EntryEstimator(const EntryEstimator&) = delete;
    EntryEstimator& operator=(const EntryEstimator&) = delete;

    // For the next picture, of count points: a quarter more than the largest recent need. The maximum decays slowly,
    // since near and far views of a scene alternate.
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
    static constexpr std::uint64_t kStep = 1 << 16;  // so that consecutive pictures can reuse the same memory
    static constexpr std::uint64_t kMaxEntries = 0x7fff0000;

    std::uint64_t* needed_;
    std::uint64_t recent_max_ = 0;
};

}  // namespace fourd::device
