// A 256-bit hash of memory contents. In practice, equal hashes mean equal contents. The hash is not cryptographic.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace fourd {

class Fingerprint {
  public:
    void add(const void* data, std::size_t bytes) {
        const unsigned char* from = static_cast<const unsigned char*>(data);
        std::uint64_t words[kLanes] = {};
        std::size_t i = 0;
        for (; i + sizeof words <= bytes; i += sizeof words) {
            std::memcpy(words, from + i, sizeof words);
            mix(words);
        }
        std::memset(words, 0, sizeof words);
        if (i < bytes) std::memcpy(words, from + i, bytes - i);
        words[kLanes - 1] ^= bytes;
        mix(words);
    }

    friend bool operator==(const Fingerprint& a, const Fingerprint& b) {
        return std::memcmp(a.state_, b.state_, sizeof a.state_) == 0;
    }

  private:
    static constexpr int kLanes = 4;  // Number of accumulators, which a processor can update in parallel.

    void mix(const std::uint64_t* words) {
        for (int lane = 0; lane < kLanes; ++lane) {
            std::uint64_t& state = state_[lane];
            // Multiplication by an odd number is invertible, so different states stay different.
            state = (state ^ words[lane]) * 0x9e3779b97f4a7c15ull;
            state ^= state >> 29;
        }
    }

    std::uint64_t state_[kLanes] = {1, 2, 3, 4};
};

}  // namespace fourd
