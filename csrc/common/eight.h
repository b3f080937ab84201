// Vectors of eight floats for any instruction set, used in loops that compilers do not vectorise automatically.
// Functions take and return vectors by pointer, because the calling convention for vectors depends on the instruction
// set.
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

// The type to which `Pointer` points, without const. The loop body of for_eights() (below) has two arguments: an index
// `i`, and a pointer `tag` to Eight or float. NumberOf<decltype(tag)> is then Eight or float, respectively.
template <typename Pointer>
using NumberOf = std::remove_const_t<std::remove_pointer_t<Pointer>>;

// Calls body(i, tag) for i in [0, count). The index i increases in steps of 8, and in steps of 1 for the last elements.
// `tag` is always null, and only its type matters. If `tag` is a pointer to Eight, the body processes the elements i to
// i + 7. If `tag` is a pointer to float, the body processes only element i.
template <typename Body>
FOURD_INLINE void for_eights(std::size_t count, const Body& body) {
    std::size_t i = 0;
#if defined(FOURD_EIGHT)
    for (; i + 8 <= count; i += 8) body(i, static_cast<const Eight*>(nullptr));
#endif
    for (; i < count; ++i) body(i, static_cast<const float*>(nullptr));
}

}  // namespace fourd
