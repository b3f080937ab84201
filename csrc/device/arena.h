// Allocates consecutive arrays in memory that the caller provides.
#pragma once

#include <cstddef>
#include <cstdint>

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/asan_interface.h>
#endif

namespace fourd::device {

// If the memory is a null pointer, the arena only counts the bytes that its arrays need.
class Arena {
  public:
    explicit Arena(void* memory) : memory_(static_cast<unsigned char*>(memory)) {}

    template <typename T>
    T* take(std::size_t count) {
        const std::size_t begin = bytes_, used = count * sizeof(T);
        bytes_ += (used + kAlign - 1) / kAlign * kAlign + kGap;
        guard(begin, used);
        return memory_ ? reinterpret_cast<T*>(memory_ + begin) : nullptr;
    }

    std::size_t bytes() const { return bytes_; }

  private:
    static constexpr std::size_t kAlign = 256;

#if defined(__SANITIZE_ADDRESS__)
    // In sanitizer builds, a poisoned gap separates the arrays, and the sanitizer reports every access to the gap.
    static constexpr std::size_t kGap = kAlign;

    void guard(std::size_t begin, std::size_t used) const {
        if (!memory_) return;
        ASAN_UNPOISON_MEMORY_REGION(memory_ + begin, used);
        ASAN_POISON_MEMORY_REGION(memory_ + begin + used, bytes_ - begin - used);
    }
#else
    static constexpr std::size_t kGap = 0;

    void guard(std::size_t, std::size_t) const {}
#endif

    unsigned char* memory_;
    std::size_t bytes_ = 0;
};

}  // namespace fourd::device
