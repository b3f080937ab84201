// The memory that a picture is made in, as it comes from Python.
#pragma once

#include "binding/require.h"
#include "binding/cuda_arrays.h"
#include "device/rooms.h"
#include "points/cuda/render.h"

namespace fourd::cuda {

struct RoomArguments {
    const device::Rooms& rooms;
    std::size_t entries;
    const Workspace& workspace;

    // Throws std::invalid_argument unless the workspace has the bytes that are needed.
    points::cuda::Room checked(std::size_t needed_bytes) const {
        require(entries <= 0x7fffffff, "entries: expected at most 2^31 - 1");
        require(workspace.size() >= needed_bytes, "workspace: expected the bytes that the plan names");
        return {workspace.data(), entries, rooms.needed()};
    }
};

}  // namespace fourd::cuda
