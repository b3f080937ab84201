// A baked frame drawn from a camera, from float16 arrays to bytes: shading and compositing in one call, in
// memory that is kept from one picture to the next. Callers check shapes; arrays are dense and row-major.
#pragma once

#include "common/buffer.h"
#include "play/frame.h"
#include "points/cpu/workspace.h"
#include "points/points.h"

namespace fourd::play {

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
