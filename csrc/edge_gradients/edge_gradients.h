// Computes the part of the gradient of the vertex positions that comes from moving visibility edges, for an image
// without antialiasing. Visibility edges are silhouette edges and the lines along which two triangles intersect. When
// vertices move, these edges move with them and change the image. Callers check shapes. Indices of vertices and
// triangles that are out of range are ignored.
#pragma once

#include "antialias/antialias.h"

namespace fourd::edge_gradients {

// Writes the gradient with respect to Mesh::positions to `positions`, an array of the same shape. `gradient` is the
// gradient of the loss with respect to Images::colours, in the shape of the colours.
void edge_gradients(const antialias::Mesh& mesh, const antialias::Images& images, const antialias::Settings& settings,
                    const float* gradient, float* positions);

}  // namespace fourd::edge_gradients
