// Non-temporal stores: stores that do not read the old content of the memory into the cache first, and do not displace
// other data from the cache. Non-temporal stores are worthwhile for large arrays that are not read soon.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "common/inline.h"

#if defined(__SSE2__) || defined(_M_X64)
#include <emmintrin.h>
#define FOURD_HAS_STREAMS
#endif

namespace fourd {

// Writes `count` copies of a word of four bytes to `to`. On processors without non-temporal stores, or if `to` is not
// aligned to 16 bytes, the stores are normal.
FOURD_INLINE void stream_words(std::uint32_t word, std::size_t count, void* to) {
    char* at = static_cast<char*>(to);
    std::size_t done = 0;
#if defined(FOURD_HAS_STREAMS)
    if (reinterpret_cast<std::uintptr_t>(to) % sizeof(__m128i) == 0) {
        const __m128i four = _mm_set1_epi32(static_cast<int>(word));
        for (; done + 4 <= count; done += 4) _mm_stream_si128(reinterpret_cast<__m128i*>(at + 4 * done), four);
    }
#endif
    for (; done < count; ++done) std::memcpy(at + 4 * done, &word, sizeof word);
}

// Call this function after the last stream_words() of a task. Without this call, another thread could read the old
// content, because atomic operations do not order non-temporal stores.
FOURD_INLINE void finish_streams() {
#if defined(FOURD_HAS_STREAMS)
    _mm_sfence();
#endif
}

}  // namespace fourd
