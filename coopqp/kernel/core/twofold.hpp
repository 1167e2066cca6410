// Numbers of twice the digits: the sum of two, the second less than the last digit of the first.
//
// After Dekker (1971) and Shewchuk (1997): the same bits everywhere, as what a product lacks is exact
// with fused multiplication and without.
#pragma once
#include <cmath>

namespace coopqp {

struct Twofold {
    double hi = 0.0, lo = 0.0;
    Twofold() = default;
    Twofold(double a) : hi(a) {}
    Twofold(double a, double b) : hi(a), lo(b) {}

    // Of a and a smaller b; of any two; their product.
    static Twofold join(double a, double b) {
        const double s = a + b;
        return {s, b - (s - a)};
    }
    static Twofold sum(double a, double b) {
        const double s = a + b, t = s - a;
        return {s, (a - (s - t)) + (b - t)};
    }
    static Twofold product(double a, double b) {
        const double p = a * b;
#if defined(__FMA__)
        return {p, std::fma(a, b, -p)};
#else
        constexpr double SPLIT = 134217729.0;  // 2^27 + 1
        const double s = SPLIT * a, t = SPLIT * b;
        const double a1 = s - (s - a), a2 = a - a1, b1 = t - (t - b), b2 = b - b1;
        return {p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2};
#endif
    }
};

inline Twofold operator-(const Twofold& a) { return {-a.hi, -a.lo}; }
inline Twofold operator+(const Twofold& a, const Twofold& b) {
    const Twofold s = Twofold::sum(a.hi, b.hi), t = Twofold::sum(a.lo, b.lo);
    const Twofold u = Twofold::join(s.hi, s.lo + t.hi);
    return Twofold::join(u.hi, u.lo + t.lo);
}
inline Twofold operator-(const Twofold& a, const Twofold& b) { return a + -b; }
inline Twofold operator*(const Twofold& a, const Twofold& b) {
    const Twofold p = Twofold::product(a.hi, b.hi);
    return Twofold::join(p.hi, p.lo + (a.hi * b.lo + a.lo * b.hi));
}
inline Twofold operator/(const Twofold& a, const Twofold& b) {
    const double first = a.hi / b.hi;
    const Twofold rest = a - b * first;
    const double second = rest.hi / b.hi;
    const Twofold last = rest - b * second;
    return Twofold::join(first, second) + Twofold(last.hi / b.hi);
}
inline Twofold& operator+=(Twofold& a, const Twofold& b) { return a = a + b; }
inline Twofold& operator-=(Twofold& a, const Twofold& b) { return a = a - b; }

}  // namespace coopqp
