// Asks the operating system to use huge pages for large arrays. On a system without MADV_HUGEPAGE, prefer_huge_pages()
// does nothing.
#pragma once

#include <cstddef>
#include <cstdint>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace fourd {

// Call this function before the first write to fresh memory. With huge pages, the first write to 50 MB takes a third of
// the time, and scattered accesses cause fewer TLB misses. The call is only a hint and does not change results.
inline void prefer_huge_pages(void* memory, std::size_t bytes) {
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    constexpr std::uintptr_t kPage = std::uintptr_t{2} << 20;
    const std::uintptr_t at = reinterpret_cast<std::uintptr_t>(memory);
    const std::uintptr_t begin = (at + kPage - 1) / kPage * kPage, end = (at + bytes) / kPage * kPage;
    if (begin < end) static_cast<void>(madvise(reinterpret_cast<void*>(begin), end - begin, MADV_HUGEPAGE));
#else
    static_cast<void>(memory), static_cast<void>(bytes);
#endif
}

}  // namespace fourd
