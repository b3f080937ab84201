// Checks arrays of indices from Python.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "binding/require.h"

namespace fourd {

// Requires that all int32 indices in an array are from 0 to `count` - 1. The array can have any shape. Arrays on a GPU
// are not checked.
template <typename Indices>
void require_indices(const Indices& indices, std::size_t count, const char* message) {
    if (indices.device_type() != nanobind::device::cpu::value) return;
    const std::int32_t* const at = indices.data();
    std::uint32_t largest = 0;  // As an unsigned integer, a negative index is larger than every valid index.
    for (std::size_t i = 0; i < indices.size(); ++i) largest = std::max(largest, static_cast<std::uint32_t>(at[i]));
    require(indices.size() == 0 || largest < count, message);
}

}  // namespace fourd
