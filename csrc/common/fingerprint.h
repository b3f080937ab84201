// A number that tells contents apart: 128 bits, so that equal ones mean equal contents in practice.
// Not for contents that an adversary chooses.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace fourd {

class Fingerprint {
  public:
    void add(const void* data, std::size_t bytes) {
        const unsigned char* from = static_cast<const unsigned char*>(data);
        std::uint64_t words[kWays] = {};
        std::size_t i = 0;
        for (; i + sizeof words <= bytes; i += sizeof words) {
            std::memcpy(words, from + i, sizeof words);
            mix(words);
        }
        std::memset(words, 0, sizeof words);
        if (i < bytes) std::memcpy(words, from + i, bytes - i);
        words[kWays - 1] ^= bytes;
        mix(words);
    }

    friend bool operator==(const Fingerprint& a, const Fingerprint& b) {
        return std::memcmp(a.state_, b.state_, sizeof a.state_) == 0;
    }

  private:
    static constexpr int kWays = 4;  // independent, so that a processor works on all at once

    void mix(const std::uint64_t* words) {
        for (int way = 0; way < kWays; ++way) {
            std::uint64_t& state = state_[way];
            state = (state ^ words[way]) * 0x9e3779b97f4a7c15ull;  // odd: no two states become one
            state ^= state >> 29;
        }
    }

    std::uint64_t state_[kWays] = {1, 2, 3, 4};
};

}  // namespace fourd
