#include "device/cuda.h"
#include "device/rooms.h"

namespace fourd::device {

std::uint64_t* allocate_shared_number() {
    void* number = nullptr;
    check(cudaHostAlloc(&number, sizeof(std::uint64_t), cudaHostAllocPortable | cudaHostAllocMapped),
          "page-locked memory");
    return static_cast<std::uint64_t*>(number);
}

void free_shared_number(std::uint64_t* number) { cudaFreeHost(number); }

}  // namespace fourd::device
