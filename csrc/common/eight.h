// Eight floats that are added and multiplied together, in code for any instruction set: where compilers do not see by
// themselves that loops can be vectors. Never passed or returned: how would depend on the instruction set.
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

// What a pointer to numbers points to: float or Eight.
template <typename Pointer>
using NumberOf = std::remove_const_t<std::remove_pointer_t<Pointer>>;

// Calls at(i, number) for i below count, in eights as long as there are eight; number's type alone tells which.
template <typename At>
FOURD_INLINE void in_eights(std::size_t count, const At& at) {
    std::size_t i = 0;
#if defined(FOURD_EIGHT)
    for (; i + 8 <= count; i += 8) at(i, static_cast<const Eight*>(nullptr));
#endif
    for (; i < count; ++i) at(i, static_cast<const float*>(nullptr));
}

}  // namespace fourd
