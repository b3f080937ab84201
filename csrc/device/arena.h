// Arrays laid one after another in memory that the caller gives.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fourd::device {

// Given no memory, an arena only counts the bytes that its arrays need.
class Arena {
  public:
    explicit Arena(void* memory) : memory_(static_cast<unsigned char*>(memory)) {}

    template <typename T>
    T* take(std::size_t count) {
        const std::size_t begin = bytes_;
        bytes_ += (count * sizeof(T) + kAlign - 1) / kAlign * kAlign;
        return memory_ ? reinterpret_cast<T*>(memory_ + begin) : nullptr;
    }

    std::size_t bytes() const { return bytes_; }

  private:
    static constexpr std::size_t kAlign = 256;
    unsigned char* memory_;
    std::size_t bytes_ = 0;
};

}  // namespace fourd::device
