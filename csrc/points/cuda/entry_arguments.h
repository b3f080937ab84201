// The scratch memory for rendering an image, which the Python caller allocates.
#pragma once

#include "binding/require.h"
#include "binding/cuda_arrays.h"
#include "device/entry_estimator.h"
#include "points/cuda/render.h"

namespace fourd::cuda {

struct EntryBufferArguments {
    const device::EntryEstimator& estimator;
    std::size_t entries;
    const Workspace& workspace;

    // Throws std::invalid_argument if the workspace has fewer than needed_bytes bytes or `entries` is above 2^31 - 1.
    points::cuda::EntryBuffer checked(std::size_t needed_bytes) const {
        require(entries <= 0x7fffffff, "entries: expected at most 2^31 - 1");
        require(workspace.size() >= needed_bytes, "workspace: expected the bytes that the plan names");
        return {workspace.data(), entries, estimator.needed()};
    }
};

}  // namespace fourd::cuda
