// How much room pictures need for their entries, learnt from those before.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace fourd::device {

// Memory of the host that the GPU writes to. Throws std::runtime_error where there is none.
std::uint64_t* allocate_shared_number();
void free_shared_number(std::uint64_t* number);

// Kept for a device as long as the process lives. The GPU is never waited for: a picture's need is seen by
// whichever picture is begun after the GPU has told it.
class Rooms {
  public:
    Rooms() : needed_(allocate_shared_number()) { *needed_ = 0; }
    ~Rooms() { free_shared_number(needed_); }
    Rooms(const Rooms&) = delete;
    Rooms& operator=(const Rooms&) = delete;

    // For the next picture, of count points: a quarter more than the largest need seen lately. A large
    // need is forgotten slowly, since a scene is drawn from near and from far in turn.
    std::size_t entries(std::size_t count) {
        const std::uint64_t needed = *static_cast<volatile std::uint64_t*>(needed_);
        kept_ = std::max(kept_ - kept_ / 64, needed);
        const std::uint64_t wanted = kept_ > 0 ? kept_ + kept_ / 4 : kFirstGuess * std::uint64_t{count};
        const std::uint64_t rounded = (wanted / kStep + 1) * kStep;
        return static_cast<std::size_t>(std::min(rounded, kMost));
    }

    std::uint64_t* needed() const { return needed_; }

  private:
    static constexpr std::uint64_t kFirstGuess = 8;
    static constexpr std::uint64_t kStep = 1 << 16;  // so that memory of one picture fits the next
    static constexpr std::uint64_t kMost = 0x7fff0000;

    std::uint64_t* needed_;
    std::uint64_t kept_ = 0;
};

}  // namespace fourd::device
