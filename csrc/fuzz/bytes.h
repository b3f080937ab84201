// Reads choices, sizes and values from the input bytes of a fuzzer.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

namespace fourd::fuzz {

// Reads bytes in order. After the last byte, all bytes are 0.
class Bytes {
  public:
    Bytes(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

    bool is_empty() const { return at_ >= size_; }
    unsigned byte() { return is_empty() ? 0u : data_[at_++]; }
    unsigned pair() { return byte() + 256u * byte(); }
    bool one_in(unsigned count) { return byte() % count == count - 1; }

    // Returns a size that is usually small. All sizes up to 72 can occur.
    std::size_t size() {
        const unsigned value = byte();
        return value % 4 == 3 ? value % 73 : value / 4 % 10;
    }

    // Fills `out` with repeated copies of the remaining bytes, without consuming them.
    void repeat(std::uint8_t* out, std::size_t count) const {
        const std::size_t left = size_ > at_ ? size_ - at_ : 0;
        for (std::size_t i = 0; i < count; ++i) out[i] = left > 0 ? data_[at_ + i % left] : 0;
    }

  private:
    const std::uint8_t* data_;
    std::size_t size_, at_ = 0;
};

// A random number generator (splitmix64) for the values of arrays, so that a few bytes of the input describe a large
// array.
class Values {
  public:
    explicit Values(std::uint64_t seed) : state_(seed) {}

    std::uint64_t bits() {
        std::uint64_t z = state_ += 0x9e3779b97f4a7c15u;
        z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
        z = (z ^ z >> 27) * 0x94d049bb133111ebu;
        return z ^ z >> 31;
    }
    double uniform(double low, double high) { return low + (high - low) * static_cast<double>(bits() >> 11) * 0x1p-53; }

    // Returns an invalid or extreme number.
    double hostile() {
        constexpr double kInfinity = std::numeric_limits<double>::infinity();
        constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
        constexpr double kNumbers[] = {kNan, kInfinity, -kInfinity, 3e38, -3e38, 1e-42, 0, -0.0, -1, 1e6};
        return kNumbers[bits() % 10];
    }

  private:
    std::uint64_t state_;
};

}  // namespace fourd::fuzz
