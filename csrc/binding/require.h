// Functions that check arguments from Python.
#pragma once

#include <algorithm>
#include <stdexcept>

namespace fourd {

// Throws std::invalid_argument, a ValueError in Python, unless the condition holds.
inline void require(bool condition, const char* message) {
    if (!condition) throw std::invalid_argument(message);
}

// The number of threads to use for a requested number.
inline int clamp_threads(int threads) { return std::clamp(threads, 1, 256); }

}  // namespace fourd
