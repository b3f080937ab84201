// Vectors of eight floats for any instruction set, for loops that compilers do not vectorise by themselves. Functions
// take and return them by pointer, because the calling convention for vectors depends on the instruction set.
#pragma once

#include <cstddef>
#include <cstring>
#include <type_traits>

#include "common/inline.h"

namespace fourd {

#if defined(__GNUC__)
#define FOURD_EIGHT
typedef float Eight __attribute__((vector_size(32)));

FOURD_INLINE void load(const float* from, Eight* to) { std::memcpy(to, from, sizeof *to); }
FOURD_INLINE void store(const Eight* from, float* to) { std::memcpy(to, from, sizeof *from); }
#endif

FOURD_INLINE void load(const float* from, float* to) { *to = *from; }
FOURD_INLINE void store(const float* from, float* to) { *to = *from; }

// The type (Eight or float) that tag points to. tag is the second argument of the body of for_eights.
template <typename Pointer>
using NumberOf = std::remove_const_t<std::remove_pointer_t<Pointer>>;

// Calls body(i, tag) for i in [0, count), first in steps of 8 and then, for the last elements, in steps of 1. tag is a
// null pointer. Its type tells the body whether to process 8 elements (Eight) or 1 element (float), starting at i.
template <typename Body>
FOURD_INLINE void for_eights(std::size_t count, const Body& body) {
    std::size_t i = 0;
#if defined(FOURD_EIGHT)
    for (; i + 8 <= count; i += 8) body(i, static_cast<const Eight*>(nullptr));
#endif
    for (; i < count; ++i) body(i, static_cast<const float*>(nullptr));
}

}  // namespace fourd
