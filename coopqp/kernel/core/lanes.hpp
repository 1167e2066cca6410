// Vectors of four numbers, and memory for arrays whose length is a multiple of four lanes.
//
// Sums are taken in one order whatever the instruction set, and contraction is switched off where
// this is compiled, so that every build gives the same bits.
#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace coopqp {

typedef double v4 __attribute__((vector_size(32), may_alias));

typedef long long v4i __attribute__((vector_size(32)));

constexpr int LANES = 4;

inline int padded(int count) { return (count + LANES - 1) / LANES * LANES; }
inline int blocks_of(int count) { return (count + LANES - 1) / LANES; }

inline v4* lanes(double* p) { return reinterpret_cast<v4*>(p); }
inline const v4* lanes(const double* p) { return reinterpret_cast<const v4*>(p); }

__attribute__((always_inline)) inline double sum(const v4& a) {
    return (a[0] + a[2]) + (a[1] + a[3]);
}

// The sums of four vectors, side by side.
__attribute__((always_inline)) inline v4 sums(const v4& a, const v4& b, const v4& c, const v4& d) {
    return v4{sum(a), sum(b), sum(c), sum(d)};
}

__attribute__((always_inline)) inline v4 larger(const v4& a, const v4& b) { return a > b ? a : b; }
__attribute__((always_inline)) inline v4 smaller(const v4& a, const v4& b) { return a < b ? a : b; }

// Products of padded arrays; `blocks` counts vectors of four.
__attribute__((always_inline)) inline double dot(const double* a, const double* b, int blocks) {
    const v4 *x = lanes(a), *y = lanes(b);
    v4 s = x[0] * y[0];
    for (int i = 1; i < blocks; i++) s += x[i] * y[i];
    return sum(s);
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
