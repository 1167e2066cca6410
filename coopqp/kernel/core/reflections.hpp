// Rows brought to lower-triangular form by Householder reflections from the right: rows = L Q'.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "lanes.hpp"

namespace coopqp {

// The reflection of a row's lanes from `first` on onto lane `first`; returns what lane `first`
// becomes, and 0 where less than `least` is there. Lanes are set by whole vectors: a number that is
// written alone makes whoever reads its vector wait. Inlined, so that loops over B blocks unroll.
__attribute__((always_inline)) inline double reflection(const double* row, int first, int blocks,
                                                        double least, double* h, double& beta) {
    v4* t = lanes(h);
    const v4* a = lanes(row);
    const int at = first / LANES, lane = first % LANES;
    const v4i index = {0, 1, 2, 3};
    for (int b = 0; b < at; b++) t[b] = v4{};
    const v4 head = index >= v4i{} + lane ? a[at] : v4{};
    v4 squares = head * head, odd = v4{};
    int b = at + 1;
    for (; b + 1 < blocks; b += 2) {
        t[b] = a[b];
        t[b + 1] = a[b + 1];
        odd += a[b] * a[b];
        squares += a[b + 1] * a[b + 1];
    }
    if (b < blocks) {
        t[b] = a[b];
        odd += a[b] * a[b];
    }
    const double size2 = sum(squares + odd), pivot = row[first];
    if (!(size2 > least * least)) return 0.0;
    const double size = std::sqrt(size2), onto = pivot > 0 ? -size : size, longer = pivot - onto;
    t[at] = index == v4i{} + lane ? v4{} + longer : head;
    beta = -1.0 / (onto * longer);
    return onto;
}

// A row once it is reflected: lanes past `last` are zero, and `last` is what it became.
inline void put_end(double* row, int last, double onto, int blocks) {
    v4* a = lanes(row);
    const int at = last / LANES;
    const v4i index = v4i{0, 1, 2, 3} + at * LANES;
    a[at] = index == v4i{} + last ? v4{} + onto : index < v4i{} + last ? a[at] : v4{};
    for (int b = at + 1; b < blocks; b++) a[b] = v4{};
}

// The same, which is also done to the `after` rows that follow. What the first of these are along
// the row is known before its length is, so that none waits for both.
__attribute__((noinline)) inline double reflect_from(double* row, int stride, int after,
                                                     int first, int blocks, double least,
                                                     double* h, double& beta) {
    double onto = 0.0;
    with(blocks, [&](auto n) {
        const v4i index = {0, 1, 2, 3};
        const std::size_t step = std::size_t(stride);
        v4 *t = lanes(h), *a = lanes(row), *b = lanes(row + step), *c = lanes(row + 2 * step),
           *d = lanes(row + 3 * step), all[4] = {};
        for (int i = 0; i < n; i++) {
            t[i] = index >= v4i{} + (first - i * LANES) ? a[i] : v4{};
            all[0] += t[i] * t[i];
            all[1] += b[i] * t[i];
            all[2] += c[i] * t[i];
            all[3] += d[i] * t[i];
        }
        const v4 along = sums(all[0], all[1], all[2], all[3]);
        const double size2 = along[0], pivot = row[first];
        if (!(size2 > least * least)) return;
        const double size = std::sqrt(size2), longer = pivot + (pivot > 0 ? size : -size);
        onto = pivot - longer;
        beta = 1.0 / (size2 + std::fabs(pivot) * size);
        const int at = first / LANES;
        t[at] = index == v4i{} + first % LANES ? v4{} + longer : t[at];
        const v4 heads = {0.0, row[step + std::size_t(first)], row[2 * step + std::size_t(first)],
                          row[3 * step + std::size_t(first)]};
        const v4 by = (along - heads * onto) * beta;
        for (int i = 0; i < n; i++) {
            b[i] -= t[i] * by[1];
            c[i] -= t[i] * by[2];
            d[i] -= t[i] * by[3];
        }
    });
    if (onto != 0.0 && after > LANES - 1)
        reflect_rows(row + LANES * stride, stride, after - LANES + 1, h, beta, blocks);
    return onto;
}

// Independent rows of B blocks of four lanes; `coordinates` says which lanes hold one, the others
// are zero.
template <int B>
class Reflections {
  public:
    static constexpr int WIDTH = B * LANES, MOST = 6;

    // count: of the rows, no more than MOST, nor than coordinates.
    void open(Arena& arena, int count, std::vector<int> coordinates) {
        count_ = count;
        lane_ = std::move(coordinates);
        h_ = arena.take(std::size_t(count + LANES) * WIDTH);
        C_ = arena.take(std::size_t(count) * WIDTH);
        units_ = arena.take(lane_.size() * WIDTH);
        for (std::size_t k = 0; k < lane_.size(); k++) units_[k * WIDTH + std::size_t(lane_[k])] = 1.0;
        beta_.assign(std::size_t(count), 0.0);
        inverse_.assign(std::size_t(count), 0.0);
    }

    // Factor rows (count, WIDTH), overwritten; false where the rows before one leave less than `least`
    // of it. Row s then holds L on the lanes of the coordinates before s. What rows are along one is
    // known before its length is, so that none waits for both.
    bool factor(double* rows, double least) {
        double *beta = beta_.data(), *inverse = inverse_.data(), along[MOST];
        const int* lane = lane_.data();
        const int count = count_;
        const v4i index = {0, 1, 2, 3};
        for (int s = 0; s < count; s++) {
            double *row = rows + s * WIDTH, *h = h_ + s * WIDTH;
            const int first = lane[s];
            for (int b = 0; b < B; b++)
                lanes(h)[b] = index >= v4i{} + (first - b * LANES) ? lanes(row)[b] : v4{};
            const double size2 = dot<B>(h, h), pivot = row[first];
            for (int j = s + 1; j < count; j++) along[j] = dot<B>(rows + j * WIDTH, h);
            if (!(size2 > least * least)) return false;
            const double size = std::sqrt(size2), longer = pivot + (pivot > 0 ? size : -size);
            const double onto = pivot - longer;
            beta[s] = 1.0 / (size2 + std::fabs(pivot) * size);
            inverse[s] = 1.0 / onto;
            v4& head = lanes(h)[first / LANES];
            head = index == v4i{} + first % LANES ? v4{} + longer : head;
            for (int j = s + 1; j < count; j++) {
                double* other = rows + j * WIDTH;
                const double by = (along[j] - other[first] * onto) * beta[s];
                for (int b = 0; b < B; b++) lanes(other)[b] -= lanes(h)[b] * by;
            }
        }
        return true;
    }

    // Q' itself, a row for each coordinate: first those that the factored rows see. All reflections
    // h_s at once, Q = I - H C' with C M' = H and M = triu(H'H), diagonal 1 / beta_s: the compact form
    // of Schreiber and Van Loan 1989, T = M^-1 after Puglisi 1992.
    void basis(double* Q) const {
        const double* beta = beta_.data();
        const int rank = count_;
        for (int s = rank; s-- > 0;) {
            const v4* h = lanes(h_ + s * WIDTH);
            v4 c[B];
            for (int b = 0; b < B; b++) c[b] = h[b];
            for (int t = s + 1; t < rank; t++) {
                const double by = dot<B>(h_ + s * WIDTH, h_ + t * WIDTH);
                for (int b = 0; b < B; b++) c[b] -= lanes(C_ + t * WIDTH)[b] * by;
            }
            for (int b = 0; b < B; b++) lanes(C_ + s * WIDTH)[b] = c[b] * beta[s];
        }
        const int count = int(lane_.size());
        for (int k = 0; k < count; k++) {
            const double* of_lane = C_ + lane_[std::size_t(k)];
            v4 row[B];
            for (int b = 0; b < B; b++) row[b] = lanes(units_ + k * WIDTH)[b];
            for (int at = 0, end = std::min(rank, k + 1) * WIDTH; at < end; at += WIDTH)
                for (int b = 0; b < B; b++) row[b] -= lanes(h_ + at)[b] * of_lane[at];
            for (int b = 0; b < B; b++) lanes(Q + k * WIDTH)[b] = row[b];
        }
    }

    // Turn the first rows of Q', those that the factored rows see, into L^-T Q': the motions that
    // change one row alone, each.
    void part(double* Q, const double* rows) const {
        for (int k = count_; k-- > 0;) {
            const double* by = rows + k * WIDTH + lane_[std::size_t(k)];
            v4 row[B];
            for (int b = 0; b < B; b++) row[b] = lanes(Q + k * WIDTH)[b];
            for (const double* other = Q + (k + 1) * WIDTH; other < Q + count_ * WIDTH; other += WIDTH) {
                by += WIDTH;
                for (int b = 0; b < B; b++) row[b] -= lanes(other)[b] * *by;
            }
            for (int b = 0; b < B; b++) lanes(Q + k * WIDTH)[b] = row[b] * inverse_[std::size_t(k)];
        }
    }

  private:
    double *h_ = nullptr, *C_ = nullptr, *units_ = nullptr;
    std::vector<double> beta_, inverse_;
    std::vector<int> lane_;
    int count_ = 0;
};

}  // namespace coopqp
