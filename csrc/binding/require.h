// Functions that check arguments from Python.
#pragma once

#include <algorithm>
#include <stdexcept>

namespace fourd {

// Throws std::invalid_argument if the condition is false. In Python, the exception is a ValueError.
inline void require(bool condition, const char* message) {
    if (!condition) throw std::invalid_argument(message);
}

// Clamps a requested number of threads to the range from 1 to 256.
inline int clamp_threads(int threads) { return std::clamp(threads, 1, 256); }

}  // namespace fourd
