// Sines and cosines of many angles at once, within two units of the last digit, with the same bits on
// every processor. Polynomials and the three parts of pi/2 are those of fdlibm (Sun Microsystems).
#pragma once
#include <cmath>

#include "lanes.hpp"

namespace coopqp {

constexpr double MOST_TURNED = 1e5;  // beyond, the library's are taken [rad]

// Of four angles no larger than MOST_TURNED.
inline void sines(const v4& angle, v4& sine, v4& cosine) {
    constexpr double FIRST = 1.57079632673412561417e+00, SECOND = 6.07710050630396597660e-11,
                     THIRD = 2.02226624879595063154e-21, TWO_BY_PI = 6.36619772367581382433e-01;
    constexpr double TO_INTEGER = 6755399441055744.0;  // 1.5 2^52: the sum's last digit is 1
    const v4 shifted = angle * TWO_BY_PI + TO_INTEGER, turns = shifted - TO_INTEGER;
    const v4i quadrant = reinterpret_cast<const v4i&>(shifted);
    const v4 x = ((angle - turns * FIRST) - turns * SECOND) - turns * THIRD, z = x * x;
    const v4 s = x + x * z *
        (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 +
        z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 +
        z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const v4 half = z * 0.5, w = 1.0 - half;
    const v4 c = w + (((1.0 - w) - half) + z * z *
        (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 +
        z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 +
        z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))));
    const v4i odd = (quadrant & 1) != 0;
    const v4 across = odd ? c : s, along = odd ? s : c;
    sine = (quadrant & 2) != 0 ? -across : across;
    cosine = ((quadrant + 1) & 2) != 0 ? -along : along;
}

// Of `blocks` times four angles.
inline void sines(const double* angles, int blocks, double* sine, double* cosine) {
    v4 most = v4{};
    for (int b = 0; b < blocks; b++) {
        const v4& x = lanes(angles)[b];
        sines(x, lanes(sine)[b], lanes(cosine)[b]);
        most = larger(most, larger(x, -x));
    }
    if (!any_above(most, MOST_TURNED)) return;
    for (int i = 0; i < blocks * LANES; i++) {
        if (std::fabs(angles[i]) <= MOST_TURNED) continue;
        sine[i] = std::sin(angles[i]);
        cosine[i] = std::cos(angles[i]);
    }
}

}  // namespace coopqp
