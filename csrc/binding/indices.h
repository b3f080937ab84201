// Checks of arrays of indices from Python.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "binding/require.h"

namespace fourd {

// Requires indices (int32) from 0 to `count` - 1, in an array of any shape. Arrays on a GPU are not checked.
template <typename Indices>
void require_indices(const Indices& indices, std::size_t count, const char* message) {
    if (indices.device_type() != nanobind::device::cpu::value) return;
    const std::int32_t* const at = indices.data();
    std::uint32_t largest = 0;  // Negative indices count as large ones.
    for (std::size_t i = 0; i < indices.size(); ++i) largest = std::max(largest, static_cast<std::uint32_t>(at[i]));
    require(indices.size() == 0 || largest < count, message);
}

}  // namespace fourd
