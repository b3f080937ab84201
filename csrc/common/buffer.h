// An array that is not initialised. The kernels write every element of a Buffer before they read it. Setting a Buffer
// to zero would take as long as sorting its elements.
#pragma once

#include <cstddef>
#include <memory>
#include <type_traits>

#include "common/pages.h"

namespace fourd {

template <typename T>
class Buffer {
    static_assert(std::is_trivially_copyable<T>::value, "elements stay uninitialised");

  public:
    Buffer() = default;
    explicit Buffer(std::size_t size) : data_(new T[size]), size_(size) {
        prefer_huge_pages(data_.get(), size * sizeof(T));
    }

    // Makes the array larger if it has fewer than `size` elements. The old contents are then lost.
    void require(std::size_t size) {
        if (size > size_) *this = Buffer(size + size / 2);
    }

    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    std::size_t size() const { return size_; }
    T& operator[](std::size_t i) { return data_[i]; }
    const T& operator[](std::size_t i) const { return data_[i]; }

  private:
    std::unique_ptr<T[]> data_;
    std::size_t size_ = 0;
};

}  // namespace fourd
