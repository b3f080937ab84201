#include "device/cuda.h"
#include "device/entry_estimator.h"

namespace fourd::device {

std::uint64_t* allocate_mapped_counter() {
    void* number = nullptr;
    check(cudaHostAlloc(&number, sizeof(std::uint64_t), cudaHostAllocPortable | cudaHostAllocMapped),
          "page-locked memory");
    return static_cast<std::uint64_t*>(number);
}

void free_mapped_counter(std::uint64_t* number) { cudaFreeHost(number); }

}  // namespace fourd::device
