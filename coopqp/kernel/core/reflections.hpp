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

// The same for P vectors of B blocks side by side in registers, one after the other in memory.
template <int B, int P>
struct Beside {
    v4 x[P][B];

    // Unit vectors, each along a lane.
    void units(const int* along) {
        const v4i index = {0, 1, 2, 3};
        for (int p = 0; p < P; p++)
            for (int b = 0; b < B; b++)
                x[p][b] = index == v4i{} + (along[p] - b * LANES) ? v4{} + 1.0 : v4{};
    }
    void store(double* to) const {
        for (int p = 0; p < P; p++)
            for (int b = 0; b < B; b++) lanes(to)[p * B + b] = x[p][b];
    }
    void reflect(const double* h, double beta) {
        const v4* t = lanes(h);
        double u[P];
        for (int p = 0; p < P; p++) {
            v4 s = t[0] * x[p][0];
            for (int b = 1; b < B; b++) s += t[b] * x[p][b];
            u[p] = beta * sum(s);
        }
        for (int p = 0; p < P; p++)
            for (int b = 0; b < B; b++) x[p][b] -= t[b] * u[p];
    }
};

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
                double* L = &L_[std::size_t(s * most_)];
                for (int k = 0; k < rank_; k++) L[k] = row[lane(k)];
                L[rank_] = onto;
            }
            beta_[std::size_t(rank_)] = beta;
            inverse_[std::size_t(rank_)] = 1.0 / onto;
            for (int j = s + 1; j < count; j++) reflect<B>(rows + j * WIDTH, h, beta);
            rank_++;
        }
        return true;
    }

    // Q' itself, a row for each coordinate: first those that the factored rows see.
    void basis(double* Q) const {
        constexpr int P = B > 8 ? 1 : B > 4 ? 2 : B > 2 ? 3 : 4;
        const int count = int(lane_.size());
        int k = 0;
        for (; k + P <= count; k += P) turn<P>(k, Q);
        for (; k < count; k++) turn<1>(k, Q);
    }

    // Turn the first rows of Q', those that the factored rows see, into L^-T Q': the motions that
    // change one row alone, each. For independent rows.
    void part(double* Q) const {
        for (int k = rank_; k-- > 0;) {
            v4 row[B];
            for (int b = 0; b < B; b++) row[b] = lanes(Q + k * WIDTH)[b];
            for (int j = k + 1; j < rank_; j++) {
                const double by = L_[std::size_t(j * most_ + k)];
                for (int b = 0; b < B; b++) row[b] -= lanes(Q + j * WIDTH)[b] * by;
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

    // P rows of Q' from row k on; reflections that come later do not touch these unit vectors.
    template <int P>
    void turn(int k, double* Q) const {
        Beside<B, P> several;
        several.units(&lane_[std::size_t(k)]);
        for (int s = std::min(rank_, k + P); s-- > 0;)
            several.reflect(h_ + s * WIDTH, beta_[std::size_t(s)]);
        several.store(Q + k * WIDTH);
    }

    double* h_ = nullptr;
    std::vector<double> beta_, inverse_, L_;
    std::vector<int> lane_;
    int most_ = 0, rank_ = 0;
};

}  // namespace coopqp
