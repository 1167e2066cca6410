// Vectors of four numbers, and memory for arrays whose length is a multiple of four lanes.
//
// Sums are taken in one order whatever the instruction set, and contraction is switched off where
// this is compiled, so that every build gives the same bits.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <vector>

namespace coopqp {

// To compilers it is a double, of which it is made, so that a loop that writes one reads no size anew.
typedef double v4 __attribute__((vector_size(32)));

typedef long long v4i __attribute__((vector_size(32), may_alias));  // of the bits of a v4, too

constexpr int LANES = 4;

inline int padded(int count) { return (count + LANES - 1) / LANES * LANES; }
inline int blocks_of(int count) { return (count + LANES - 1) / LANES; }

inline v4* lanes(double* p) { return reinterpret_cast<v4*>(p); }
inline const v4* lanes(const double* p) { return reinterpret_cast<const v4*>(p); }

__attribute__((always_inline)) inline double sum(const v4& a) {
    return (a[0] + a[2]) + (a[1] + a[3]);
}

// Four lanes of two vectors, by number; those of b count on from four.
template <int I, int J, int K, int L>
__attribute__((always_inline)) inline v4 pick(const v4& a, const v4& b) {
#if defined(__clang__)
    return __builtin_shufflevector(a, b, I, J, K, L);
#else
    return __builtin_shuffle(a, b, v4i{I, J, K, L});
#endif
}

// The sums of four vectors, side by side.
__attribute__((always_inline)) inline v4 sums(const v4& a, const v4& b, const v4& c, const v4& d) {
    const v4 ab = pick<0, 4, 2, 6>(a, b) + pick<1, 5, 3, 7>(a, b);
    const v4 cd = pick<0, 4, 2, 6>(c, d) + pick<1, 5, 3, 7>(c, d);
    return pick<0, 1, 4, 5>(ab, cd) + pick<2, 3, 6, 7>(ab, cd);
}

__attribute__((always_inline)) inline v4 larger(const v4& a, const v4& b) { return a > b ? a : b; }
__attribute__((always_inline)) inline double largest(const v4& a) {
    return std::max(std::max(a[0], a[1]), std::max(a[2], a[3]));
}
__attribute__((always_inline)) inline v4 smaller(const v4& a, const v4& b) { return a < b ? a : b; }
__attribute__((always_inline)) inline v4 magnitude(const v4& a) { return larger(a, -a); }

__attribute__((always_inline)) inline bool any_above(const v4& a, double most) {
    return std::max(std::max(a[0], a[1]), std::max(a[2], a[3])) > most;
}

// Products of padded arrays; `blocks` counts vectors of four.
__attribute__((always_inline)) inline double dot(const double* a, const double* b, int blocks) {
    const v4 *x = lanes(a), *y = lanes(b);
    v4 s = x[0] * y[0];
    for (int i = 1; i < blocks; i++) s += x[i] * y[i];
    return sum(s);
}

// The same, where the number is known: both halves side by side, since each sum waits for the last.
template <int B>
__attribute__((always_inline)) inline double dot(const double* a, const double* b) {
    const v4 *x = lanes(a), *y = lanes(b);
    v4 s = x[0] * y[0], other = v4{};
    for (int i = 1; i < (B + 1) / 2; i++) s += x[i] * y[i];
    for (int i = (B + 1) / 2; i < B; i++) other += x[i] * y[i];
    return sum(s + other);
}

__attribute__((always_inline)) inline void add(double* a, const double* b, double factor,
                                               int blocks) {
    v4* x = lanes(a);
    const v4* y = lanes(b);
    for (int i = 0; i < blocks; i++) x[i] += y[i] * factor;
}

// The same of six rows, one after the other in memory.
__attribute__((always_inline)) inline void add_six(double* a, const double* rows,
                                                   const double* factor, int blocks) {
    v4* x = lanes(a);
    for (int i = 0; i < blocks; i++) {
        v4 all = x[i];
        for (int r = 0; r < 6; r++) all += lanes(rows)[r * blocks + i] * factor[r];
        x[i] = all;
    }
}

// The unit vector along a lane.
__attribute__((always_inline)) inline void unit(double* a, int along, int blocks) {
    const v4i index = {0, 1, 2, 3};
    for (int b = 0; b < blocks; b++)
        lanes(a)[b] = index == v4i{} + (along - b * LANES) ? v4{} + 1.0 : v4{};
}

// Lanes of a from `first` on, the others zero.
__attribute__((always_inline)) inline void copy_from(double* out, const double* a, int first,
                                                     int blocks) {
    const v4i index = {0, 1, 2, 3};
    for (int b = 0; b < blocks; b++)
        lanes(out)[b] = index >= v4i{} + (first - b * LANES) ? lanes(a)[b] : v4{};
}

// How many blocks, where the compiler knows: loops over them are then none.
template <int N>
using Blocks = std::integral_constant<int, N>;

// Call with the number of blocks, known to the compiler where it is a frequent one.
template <class Body>
__attribute__((always_inline)) inline void with(int blocks, const Body& body) {
    if (blocks == 1) return body(Blocks<1>{});
    if (blocks == 2) return body(Blocks<2>{});
    if (blocks == 3) return body(Blocks<3>{});
    if (blocks == 4) return body(Blocks<4>{});
    if (blocks == 5) return body(Blocks<5>{});
    if (blocks == 6) return body(Blocks<6>{});
    body(blocks);
}

// Matrices whose rows are `stride` numbers apart. Rows are taken four at a time, so that there is room
// for a multiple of four; those that are none of the `count` hold zeros, or numbers nobody reads.

// out = A x, four lanes of it at a time.
template <class N>
__attribute__((always_inline)) inline void multiply(double* out, const double* A, int stride,
                                                    int count, const double* x, N blocks) {
    for (int r = 0; r < count; r += LANES) {
        const double* row = A + std::size_t(r) * std::size_t(stride);
        const v4 *a = lanes(row), *b = lanes(row + stride), *c = lanes(row + 2 * stride),
                 *d = lanes(row + 3 * stride), *y = lanes(x);
        v4 all[4] = {a[0] * y[0], b[0] * y[0], c[0] * y[0], d[0] * y[0]};
        for (int i = 1; i < blocks; i++) {
            all[0] += a[i] * y[i];
            all[1] += b[i] * y[i];
            all[2] += c[i] * y[i];
            all[3] += d[i] * y[i];
        }
        lanes(out)[r / LANES] = sums(all[0], all[1], all[2], all[3]);
    }
}
__attribute__((noinline)) inline void multiply(double* out, const double* A, int stride, int count,
                                               const double* x, int blocks) {
    with(blocks, [&](auto n) { multiply<decltype(n)>(out, A, stride, count, x, n); });
}

// y += A' x; x is zero past `count`.
template <class N>
__attribute__((always_inline)) inline void add_rows(double* y, const double* A, int stride,
                                                    int count, const double* x, N blocks) {
    for (int r = 0; r < count; r += LANES) {
        const double *row = A + std::size_t(r) * std::size_t(stride), *f = x + r;
        const v4 *a = lanes(row), *b = lanes(row + stride), *c = lanes(row + 2 * stride),
                 *d = lanes(row + 3 * stride);
        const double f0 = f[0], f1 = f[1], f2 = f[2], f3 = f[3];
        for (int i = 0; i < blocks; i++)
            lanes(y)[i] += (a[i] * f0 + b[i] * f1) + (c[i] * f2 + d[i] * f3);
    }
}
__attribute__((noinline)) inline void add_rows(double* y, const double* A, int stride, int count,
                                               const double* x, int blocks) {
    with(blocks, [&](auto n) { add_rows<decltype(n)>(y, A, stride, count, x, n); });
}

// A -= factor (A h) h'
__attribute__((noinline)) inline void reflect_rows(double* A, int stride, int count,
                                                   const double* h, double factor, int blocks) {
    with(blocks, [&](auto n) {
        for (int r = 0; r < count; r += LANES) {
            double* row = A + std::size_t(r) * std::size_t(stride);
            alignas(32) double by[LANES];
            multiply<decltype(n)>(by, row, stride, LANES, h, n);
            const v4 u = lanes(by)[0] * factor;
            for (int k = 0; k < LANES; k++)
                for (int i = 0; i < n; i++) lanes(row + k * stride)[i] -= lanes(h)[i] * u[k];
        }
    });
}

// A -= factor h (h'A), h zero past `count`.
__attribute__((noinline)) inline void reflect_columns(double* A, int stride, int count,
                                                      const double* h, double factor, int blocks,
                                                      double* scratch) {
    with(blocks, [&](auto n) {
        for (int i = 0; i < n; i++) lanes(scratch)[i] = v4{};
        add_rows<decltype(n)>(scratch, A, stride, count, h, n);
        for (int i = 0; i < n; i++) lanes(scratch)[i] *= factor;
        for (int r = 0; r < count; r++)
            for (int i = 0; i < n; i++)
                lanes(A + std::size_t(r) * std::size_t(stride))[i] -= lanes(scratch)[i] * h[r];
    });
}

// A few blocks each: a call of the library takes longer. The empty statement keeps compilers from
// making one of the loop.
__attribute__((always_inline)) inline void clear(double* a, int blocks) {
    v4* x = lanes(a);
    for (int i = 0; i < blocks; i++) {
        __asm__("" : "+r"(x));
        x[i] = v4{};
    }
}
__attribute__((always_inline)) inline void copy(double* a, const double* b, int blocks) {
    v4* x = lanes(a);
    const v4* y = lanes(b);
    for (int i = 0; i < blocks; i++) {
        __asm__("" : "+r"(x));
        x[i] = y[i];
    }
}

// Zeroed arrays that live as long as their owner, each on a boundary of 64 bytes.
class Arena {
  public:
    Arena() = default;
    Arena(const Arena&) = delete;
    Arena& operator=(const Arena&) = delete;

    double* take(std::size_t count) {
        const std::size_t line = 8, size = (count + line - 1) / line * line + line;
        chunks_.emplace_back(size + line, 0.0);
        auto at = reinterpret_cast<std::uintptr_t>(chunks_.back().data());
        return reinterpret_cast<double*>((at + 63) / 64 * 64);
    }

  private:
    std::vector<std::vector<double>> chunks_;
};

}  // namespace coopqp
