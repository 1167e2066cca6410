// Left singular vectors by one-sided Jacobi rotations (Hestenes 1958), in the caller's own thread.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "lanes.hpp"

namespace coopqp {

// Of A (n, m), row by row: values, largest first, shape (m,), and U (n, n) row by row, orthogonal,
// whose first columns belong to them; directions below `nothing` of the largest are any of the rest.
inline void left_singular(const double* A, int n, int m, double nothing, double* values, double* U) {
    constexpr int SWEEPS = 30;
    constexpr double ORTHOGONAL = 1e-15;
    Arena arena;
    const int blocks = blocks_of(n), stride = padded(n);
    std::vector<double*> column;
    for (int k = 0; k < m + n; k++) column.push_back(arena.take(std::size_t(stride)));
    for (int k = 0; k < m; k++)
        for (int i = 0; i < n; i++) column[std::size_t(k)][i] = A[i * m + k];
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        bool turned = false;
        for (int p = 0; p < m; p++)
            for (int q = p + 1; q < m; q++) {
                double *a = column[std::size_t(p)], *b = column[std::size_t(q)];
                const double aa = dot(a, a, blocks), bb = dot(b, b, blocks), ab = dot(a, b, blocks);
                if (!(std::fabs(ab) > ORTHOGONAL * std::sqrt(aa * bb))) continue;
                turned = true;
                const double zeta = (bb - aa) / (2.0 * ab);
                const double t = std::copysign(1.0, zeta) / (std::fabs(zeta) + std::sqrt(1.0 + zeta * zeta));
                const double c = 1.0 / std::sqrt(1.0 + t * t), s = c * t;
                for (int i = 0; i < blocks; i++) {
                    const v4 x = lanes(a)[i], y = lanes(b)[i];
                    lanes(a)[i] = x * c - y * s;
                    lanes(b)[i] = x * s + y * c;
                }
            }
        if (!turned) break;
    }
    const auto size = [&](const double* a) { return std::sqrt(dot(a, a, blocks)); };
    std::sort(column.begin(), column.begin() + m,
              [&](const double* a, const double* b) { return size(a) > size(b); });
    int found = 0;
    for (int k = 0; k < m; k++) {
        values[k] = size(column[std::size_t(k)]);
        if (k >= n || !(values[k] > nothing * values[0])) continue;
        for (int i = 0; i < blocks; i++) lanes(column[std::size_t(k)])[i] /= v4{} + values[k];
        found = k + 1;
    }
    // The rest: what the others leave of the unit vector of which they leave most.
    std::vector<double> left(std::size_t(n), 1.0);
    const auto take = [&](int k) {
        for (int i = 0; i < n; i++) left[std::size_t(i)] -= column[std::size_t(k)][i] * column[std::size_t(k)][i];
    };
    for (int k = 0; k < found; k++) take(k);
    for (int k = found; k < n; k++) {
        double* a = column[std::size_t(k)] = column[std::size_t(m + k)];
        a[std::max_element(left.begin(), left.end()) - left.begin()] = 1.0;
        for (int twice = 0; twice < 2; twice++)
            for (int j = 0; j < k; j++) add(a, column[std::size_t(j)], -dot(a, column[std::size_t(j)], blocks), blocks);
        const double length = size(a);
        for (int i = 0; i < blocks; i++) lanes(a)[i] /= v4{} + length;
        take(k);
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < n; k++) U[i * n + k] = column[std::size_t(k)][i];
}

}  // namespace coopqp
