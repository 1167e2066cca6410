// Rows brought to lower-triangular form by Householder reflections from the right: rows = L Q'.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "lanes.hpp"

namespace coopqp {

template <int B>
__attribute__((always_inline)) inline void reflect(double* x, const double* h, double beta) {
    v4* a = lanes(x);
    const v4* t = lanes(h);
    const double u = beta * dot<B>(x, h);
    for (int b = 0; b < B; b++) a[b] -= t[b] * u;
}

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

// Up to `most` rows of B blocks of four lanes; `coordinates` says which lanes hold one, the others
// are zero.
template <int B>
class Reflections {
  public:
    static constexpr int WIDTH = B * LANES;

    void open(Arena& arena, int most, std::vector<int> coordinates) {
        most_ = most;
        lane_ = std::move(coordinates);
        h_ = arena.take(std::size_t(most) * WIDTH);
        C_ = arena.take(std::size_t(most) * WIDTH);
        units_ = arena.take(lane_.size() * WIDTH);
        for (std::size_t k = 0; k < lane_.size(); k++) units_[k * WIDTH + std::size_t(lane_[k])] = 1.0;
        L_.assign(std::size_t(most) * std::size_t(most), 0.0);
        beta_.assign(std::size_t(most), 0.0);
        inverse_.assign(std::size_t(most), 0.0);
    }

    // Factor rows (count, WIDTH), overwritten. A row of which the rows before it leave less than
    // `least` brings no reflection; false where that is not allowed.
    bool factor(double* rows, int count, double least, bool independent) {
        rank_ = 0;
        const int most = std::min(most_, int(lane_.size()));
        for (int s = 0; s < count; s++) {
            double *row = rows + s * WIDTH, *h = h_ + rank_ * WIDTH, beta = 0.0;
            const double onto =
                rank_ < most ? reflection(row, lane(rank_), B, least, h, beta) : 0.0;
            if (onto == 0.0) {
                if (independent) return false;
                continue;
            }
            if (s < most_) {
                double* L = L_.data() + s * most_;
                const int* lane = lane_.data();
                for (int k = 0; k < rank_; k++) L[k] = row[lane[k]];
                L[rank_] = onto;
            }
            beta_[std::size_t(rank_)] = beta;
            inverse_[std::size_t(rank_)] = 1.0 / onto;
            for (int j = s + 1; j < count; j++) reflect<B>(rows + j * WIDTH, h, beta);
            rank_++;
        }
        return true;
    }

    // Q' itself, a row for each coordinate: first those that the factored rows see. All reflections
    // h_s at once, Q = I - H C' with C M' = H and M = triu(H'H), diagonal 1 / beta_s: the compact form
    // of Schreiber and Van Loan 1989, T = M^-1 after Puglisi 1992.
    void basis(double* Q) const {
        const double* beta = beta_.data();
        for (int s = rank_; s-- > 0;) {
            const v4* h = lanes(h_ + s * WIDTH);
            v4 c[B];
            for (int b = 0; b < B; b++) c[b] = h[b];
            for (int t = s + 1; t < rank_; t++) {
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
            for (int at = 0, end = std::min(rank_, k + 1) * WIDTH; at < end; at += WIDTH)
                for (int b = 0; b < B; b++) row[b] -= lanes(h_ + at)[b] * of_lane[at];
            for (int b = 0; b < B; b++) lanes(Q + k * WIDTH)[b] = row[b];
        }
    }

    // Turn the first rows of Q', those that the factored rows see, into L^-T Q': the motions that
    // change one row alone, each. For independent rows.
    void part(double* Q) const {
        for (int k = rank_; k-- > 0;) {
            const double* by = L_.data() + k * most_ + k;
            v4 row[B];
            for (int b = 0; b < B; b++) row[b] = lanes(Q + k * WIDTH)[b];
            for (const double* other = Q + (k + 1) * WIDTH; other < Q + rank_ * WIDTH; other += WIDTH) {
                by += most_;
                for (int b = 0; b < B; b++) row[b] -= lanes(other)[b] * *by;
            }
            for (int b = 0; b < B; b++) lanes(Q + k * WIDTH)[b] = row[b] * inverse_[std::size_t(k)];
        }
    }

    // X Q, in place; X has a column for each coordinate, one after the other in memory. For
    // coordinates that hold the first lanes.
    void mix(double* X) const {
        for (int s = 0; s < rank_; s++) {
            const double* h = h_ + s * WIDTH;
            v4 all[B] = {};
            for (int i = s; i < int(lane_.size()); i++)
                for (int b = 0; b < B; b++) all[b] += lanes(X)[i * B + b] * h[i];
            for (int b = 0; b < B; b++) all[b] *= beta_[std::size_t(s)];
            for (int i = s; i < int(lane_.size()); i++)
                for (int b = 0; b < B; b++) lanes(X)[i * B + b] -= all[b] * h[i];
        }
    }

  private:
    int lane(int coordinate) const { return lane_[std::size_t(coordinate)]; }

    double *h_ = nullptr, *C_ = nullptr, *units_ = nullptr;
    std::vector<double> beta_, inverse_, L_;
    std::vector<int> lane_;
    int most_ = 0, rank_ = 0;
};

}  // namespace coopqp
