// Draws baked frames (play/frame.h), whose arrays are mostly float16, and sorts their points by depth. Player and
// DepthSorter keep their memory for the next image. Callers check shapes, and arrays are dense and row-major.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/buffer.h"
#include "pixel_filter/pixel_filter.h"
#include "play/frame.h"
#include "points/cpu/bins.h"
#include "points/cpu/workspace.h"
#include "points/points.h"

namespace fourd::play {

// The radii and densities of the points of a frame, as float32.
struct Sizes {
    Buffer<float> radius, density;

    void require(std::size_t count);
    void convert(const Frame& frame, std::size_t begin, std::size_t end);
    // Fades the densities of points at the near plane (play/near_fade.h). Call convert() first.
    void fade(const Frame& frame, const points::Settings& settings, std::size_t begin, std::size_t end);
};

// Remembers which tiles have no points in the image that was last drawn to a points::Surface (colours, depths and
// normals of the visible surface). A tile that had no points in the last image, and still has none, is not drawn again.
class EmptyTiles {
  public:
    // Call this function before the tiles of a surface are drawn.
    void start(const points::Surface& surface, int width, int height, std::size_t tiles);
    // Records whether a tile has no points. Returns true if the tile is empty and was also drawn empty in the last
    // image.
    bool is_drawn(int tile, bool is_empty);

  private:
    points::Surface surface_{};
    int width_ = 0, height_ = 0;
    // True if the arrays of the surface still contain the last image, so that tiles that are empty in both images need
    // not be drawn again. This is the case if Surface::persistence is above 0, and the arrays, the image size and the
    // background are the same as for the last image.
    bool is_kept_ = false;
    std::vector<std::uint8_t> empty_;
};

// Shades and composites a frame into an 8-bit image, in one call.
class Player {
  public:
    // `settings` and `shading` must have the same `threads` and the same `simd`. canvas.rgba has the image size of
    // settings.camera. `filter_side` is the weight of a neighbour in the pixel filter (pixel_filter/pixel_filter.h), or
    // 0 for no filter.
    void draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
              const points::Canvas& canvas, float filter_side);

    // Draws the same colours as draw(), and the depths and normals of the visible surface. frame.normals must not be
    // null.
    void draw_surface(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                      const points::Surface& surface);

  private:
    // Projects and shades the points of the frame. Calls work(first, last) for each range [first, last) of points that
    // were shaded.
    template <typename Work>
    points::Cloud prepare(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                          Team& team, const Work& work);
    // Splits the points [begin, end) into short ranges, and calls work(first, last) for each range that has a visible
    // point.
    template <typename Work>
    void for_visible(std::size_t begin, std::size_t end, const Work& work) const;
    // Returns the region of the image outside of which the pixel filter changes nothing: the bounding box of all tiles
    // that have points, enlarged by one pixel.
    pixel_filter::Region filtered_region(int width, int height) const;

    points::Workspace workspace_;
    Sizes sizes_;
    Buffer<float> colour_, surface_features_;
    EmptyTiles empty_tiles_;
    Buffer<std::uint8_t> filter_scratch_;
};

// Sorts points by depth, for renderers that need a depth order.
class DepthSorter {
  public:
    // Writes the indices of the visible points to `out` (count,), nearest first, and returns the number of visible
    // points. Points of equal depth are ordered by index. settings.layers is ignored.
    std::size_t sort(const Frame& frame, const points::Settings& settings, std::uint32_t* out);

  private:
    points::Bins bins_;
    Sizes sizes_;
};

}  // namespace fourd::play
