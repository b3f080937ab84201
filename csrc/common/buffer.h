// An array that is not initialised. The kernels write every element of a Buffer before they read it. Buffers are not
// set to zero first: for an array of several megabytes, this would take as long as sorting the array, which would slow
// down the kernels.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <memory>
#include <new>
#include <type_traits>

#include "common/inline.h"
#include "common/pages.h"

namespace fourd {

// Arrays are aligned to cache lines, so an element whose size divides the size of a cache line never lies in two of
// them. With the 16-byte alignment of `new`, half of a renderer's scattered reads of 32-byte elements could need two
// cache lines.
template <typename T>
class Buffer {
    static_assert(std::is_trivially_copyable<T>::value, "elements stay uninitialised");

  public:
    Buffer() = default;
    explicit Buffer(std::size_t size) : data_(allocate(size)), size_(size) {
        prefer_huge_pages(data_.get(), size * sizeof(T));
    }

    // If the array has fewer than `size` elements, makes it larger and discards its contents.
    void require(std::size_t size) {
        if (size > size_) *this = Buffer(size + size / 2);
    }

    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    std::size_t size() const { return size_; }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }

  private:
    static constexpr std::align_val_t kAlignment{std::max(kCacheLine, alignof(T))};

    struct Free {
        void operator()(T* data) const { ::operator delete(data, kAlignment); }
    };

    static T* allocate(std::size_t size) {
        if (size > std::numeric_limits<std::size_t>::max() / sizeof(T)) throw std::bad_array_new_length();
        T* data = static_cast<T*>(::operator new(size * sizeof(T), kAlignment));
        std::uninitialized_default_construct_n(data, size);
        return data;
    }

    std::unique_ptr<T[], Free> data_;
    std::size_t size_ = 0;
};

}  // namespace fourd
