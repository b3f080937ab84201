// A baked frame drawn from a camera, from float16 arrays to bytes: shading and compositing in one call, in
// memory that is kept from one picture to the next. Callers check shapes; arrays are dense and row-major.
#pragma once

#include <cstdint>

#include "common/buffer.h"
#include "points/cpu/workspace.h"
#include "points/points.h"
#include "shade/shade.h"

namespace fourd::play {

struct Frame {
    shade::Points points;
    const std::uint16_t* radius;   // (count,) float16, world units
    const std::uint16_t* density;  // (count,) float16
};

class Player {
  public:
    // settings and shading agree on threads and simd. canvas.rgba has room for the camera's pixels.
    void draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
              const points::Canvas& canvas);

  private:
    points::Workspace space_;
    Buffer<float> radius_, density_, colour_;
};

}  // namespace fourd::play
