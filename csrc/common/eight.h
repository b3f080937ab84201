// Vectors of eight floats for any instruction set, where compilers do not vectorise a loop by themselves. Never passed
// or returned by value: the calling convention depends on the instruction set.
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

// float or Eight: the type that the second argument of for_eights' body points to.
template <typename Pointer>
using NumberOf = std::remove_const_t<std::remove_pointer_t<Pointer>>;

// Calls body(i, number) for i below count, eight at a time while eight are left. number is null: its type, a pointer to
// Eight or to float, is how many elements from i on the call is for.
template <typename Body>
FOURD_INLINE void for_eights(std::size_t count, const Body& body) {
    std::size_t i = 0;
#if defined(FOURD_EIGHT)
    for (; i + 8 <= count; i += 8) body(i, static_cast<const Eight*>(nullptr));
#endif
    for (; i < count; ++i) body(i, static_cast<const float*>(nullptr));
}

}  // namespace fourd
