// The blend head of one block of points, with its gradient. heads/cpu/loops.cpp includes this file inside its
// namespace. The hidden layer of a view is computed again for the gradient, because reading it from memory would take
// as long.

// The samples of a view as a matrix (points, channels).
inline Strided samples_of(const Job& job, int view, std::size_t first) {
    const std::size_t points = job.inputs->count;
    return {job.inputs->samples + static_cast<std::size_t>(view) * job.sizes->channels * points + first, 1, points};
}

// The product that computes the hidden layer of a view. `point` is the part of the layer that all views share.
inline Product blend_layer(const Job& job, const Rows& point) {
    const Packed& packed = *job.packed;
    return {packed.image_columns, static_cast<std::size_t>(job.sizes->hidden_stride()), job.sizes->channels, point,
            kZeros};
}

// Adds the products of C vectors of the hidden layer and of the last layer's weights to `sum`.
template <int R, int C>
FOURD_INLINE void add_to_logits(const Strided& samples, const Product& layer, const float* weights, int row, int column,
                                Vector (&sum)[R]) {
    Vector hidden[R][C];
    tile_sums(samples, layer, row, column, hidden);
FOURD_UNROLL
    for (int v = 0; v < C; ++v) {
        Vector weight;
        read(weights + column + v * kNative, weight);
FOURD_UNROLL
        for (int r = 0; r < R; ++r) {
            keep_positive(hidden[r][v], hidden[r][v]);
            multiply_add(hidden[r][v], weight, sum[r]);
        }
    }
}

template <int R>
FOURD_INLINE void raw_logits(const Job& job, const Strided& samples, const Product& layer, int row, float* out) {
    const float* weights = job.packed->out;
    const int hidden = job.sizes->hidden_stride();
    Vector sum[R] = {};
    int u = 0;
    for (; u + 2 * kNative <= hidden; u += 2 * kNative) add_to_logits<R, 2>(samples, layer, weights, row, u, sum);
    for (; u < hidden; u += kNative) add_to_logits<R, 1>(samples, layer, weights, row, u, sum);
FOURD_UNROLL
    for (int r = 0; r < R; ++r) out[row + r] = sum_of(sum[r]);
}

// Computes the logits of all views. Their rows begin as far apart as those of the inputs.
inline void blend_logits(const Job& job, const Rows& point, std::size_t first, int count, float* logits) {
    const Product layer = blend_layer(job, point);
    const float bias = *job.packed->out_bias, range = job.settings->logit_range;
    for (int view = 0; view < job.sizes->views; ++view, logits += job.inputs->count) {
        const Strided samples = samples_of(job, view, first);
        int i = 0;
        for (; i + kTileRows <= count; i += kTileRows) raw_logits<kTileRows>(job, samples, layer, i, logits);
        for (; i < count; ++i) raw_logits<1>(job, samples, layer, i, logits);
        for (i = 0; i < count; ++i) logits[i] = range * fast_tanh((logits[i] + bias) / range);
    }
}

// What the gradient of a view's hidden layer reads and writes.
struct BlendStep {
    const float *to_raw, *weights;  // The gradients of the logits before tanh, and the weights of the last layer.
    float *hidden, *point, *out;    // Gradients: of the hidden layer, which is written, and of its part that all views
                                    // share and of the last layer's weights, to which is added.
    std::size_t hidden_step, point_step;
};

template <int R, int C>
FOURD_INLINE void blend_tile_backward(const Strided& samples, const Product& layer, const BlendStep& step, int row,
                                      int column) {
    Vector hidden[R][C];
    tile_sums(samples, layer, row, column, hidden);
FOURD_UNROLL
    for (int v = 0; v < C; ++v) {
        const int at = column + v * kNative;
        Vector weight, sum;
        read(step.weights + at, weight);
        read(step.out + at, sum);
FOURD_UNROLL
        for (int r = 0; r < R; ++r) {
            const float gradient = step.to_raw[row + r];
            float* to_point = step.point + (row + r) * step.point_step + at;
            Vector product = {}, total;
            multiply_add(gradient, weight, product);
            keep_positive(hidden[r][v], product);
            write(product, step.hidden + (row + r) * step.hidden_step + at);
            read(to_point, total);
            multiply_add(1.0f, product, total);
            write(total, to_point);
            keep_positive(hidden[r][v], hidden[r][v]);
            multiply_add(gradient, hidden[r][v], sum);
        }
        write(sum, step.out + at);
    }
}

template <int C>
inline void blend_panel_backward(const Strided& samples, const Product& layer, const BlendStep& step, int count,
                                 int column) {
    int i = 0;
    for (; i + kTileRows <= count; i += kTileRows) blend_tile_backward<kTileRows, C>(samples, layer, step, i, column);
    for (; i < count; ++i) blend_tile_backward<1, C>(samples, layer, step, i, column);
}

// Computes the gradients of the blend head, from the gradients of the logits before tanh and of the mixed colours.
inline void blend_backward(const Job& job, const Workspace& space, const Shapes& at, const Rows& point,
                           std::size_t first, int count, const Gradients& out, const Sums& sums) {
    const Product layer = blend_layer(job, point);
    const int channels = at.sizes.channels, hidden = at.hidden;
    const std::size_t points = job.inputs->count, rows = at.hidden, wide = at.channels;
    float* to_point = space.grad_first + hidden;
    for (int i = 0; i < count; ++i) clear(to_point + static_cast<std::size_t>(i) * at.first, rows);
    for (int view = 0; view < at.sizes.views; ++view) {
        const Strided samples = samples_of(job, view, first);
        const float* to_raw = space.grad_logits + view * kBlock;
        const BlendStep step{to_raw,   job.packed->out, space.back,
                             to_point, sums.out,        rows,       static_cast<std::size_t>(at.first)};
        for (int i = 0; i < count; ++i) *sums.out_bias += to_raw[i];
        int u = 0;
        for (; u + 2 * kNative <= hidden; u += 2 * kNative) blend_panel_backward<2>(samples, layer, step, count, u);
        for (; u < hidden; u += kNative) blend_panel_backward<1>(samples, layer, step, count, u);
        add_product(transposed(samples), channels, space.back, rows, count, sums.image_columns, rows, hidden);
        product(rows_of(space.back, rows), count, {job.packed->image, wide, at.sizes.hidden, kZeros, kZeros},
                space.wide, wide, at.channels);
        float* to = out.samples + static_cast<std::size_t>(view) * channels * points + first;
        const float* colours = space.grad_mixed + view * 3 * kBlock;
        for (int c = 0; c < channels; ++c, to += points) {
            for (int i = 0; i < count; ++i) to[i] = space.wide[i * wide + c];
            if (c < channels - 3) continue;
            for (int i = 0; i < count; ++i) to[i] += colours[(c - (channels - 3)) * kBlock + i];
        }
    }
}
