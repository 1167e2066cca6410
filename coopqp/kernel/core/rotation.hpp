// Rotations: exponential, logarithm and its Jacobian, row-major 3 x 3.
#pragma once
#include <algorithm>
#include <cmath>

namespace coopqp {

inline double dot3(const double* a, const double* b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

inline void cross3(const double* a, const double* b, double* out) {
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
}

inline void times3(const double* A, const double* x, double* out) {
    for (int i = 0; i < 3; i++) out[i] = dot3(A + 3 * i, x);
}

inline void transposed_times3(const double* A, const double* x, double* out) {
    for (int i = 0; i < 3; i++) out[i] = A[i] * x[0] + A[3 + i] * x[1] + A[6 + i] * x[2];
}

inline void product(const double* A, const double* B, double* out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

// A B'
inline void product_transposed(const double* A, const double* B, double* out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) out[3 * i + j] = dot3(A + 3 * i, B + 3 * j);
}

// exp of a rotation vector.
inline void exp3(const double* w, double* R) {
    const double t2 = dot3(w, w);
    double a, b;  // sin t / t, (1 - cos t) / t^2
    if (t2 < 1e-4) {
        a = 1 - t2 / 6 * (1 - t2 / 20 * (1 - t2 / 42));
        b = 0.5 - t2 / 24 * (1 - t2 / 30 * (1 - t2 / 56));
    } else {
        const double t = std::sqrt(t2), s = std::sin(0.5 * t);
        a = std::sin(t) / t;
        b = 2 * s * s / t2;
    }
    const double x = w[0], y = w[1], z = w[2];
    R[0] = 1 - b * (y * y + z * z);
    R[1] = b * x * y - a * z;
    R[2] = b * x * z + a * y;
    R[3] = b * x * y + a * z;
    R[4] = 1 - b * (x * x + z * z);
    R[5] = b * y * z - a * x;
    R[6] = b * x * z - a * y;
    R[7] = b * y * z + a * x;
    R[8] = 1 - b * (x * x + y * y);
}

// Rotation vector of R, its angle in [0, pi]. Past 135 degrees by way of the quaternion, whose
// largest part says the axis without cancellation.
inline void log3(const double* R, double* w) {
    const double s[3] = {R[7] - R[5], R[2] - R[6], R[3] - R[1]};
    const double cosine = 0.5 * (R[0] + R[4] + R[8] - 1), sine2 = 0.25 * dot3(s, s);
    if (cosine > -0.7) {
        const double sine = std::sqrt(sine2);
        double f;  // t / (2 sin t)
        if (cosine > 0 && sine2 < 1e-3)
            f = 0.5 * (1 + sine2 * (1. / 6 + sine2 * (3. / 40 + sine2 * (15. / 336 + sine2 * (105. / 3456 + sine2 * (945. / 42240))))));
        else
            f = 0.5 * std::atan2(sine, cosine) / sine;
        for (int i = 0; i < 3; i++) w[i] = f * s[i];
        return;
    }
    const double diagonal[3] = {R[0], R[4], R[8]};
    const int i = int(std::max_element(diagonal, diagonal + 3) - diagonal);
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    double q[3];  // twice the vector part, times its largest entry
    q[i] = 1 + diagonal[i] - diagonal[j] - diagonal[k];
    q[j] = R[3 * j + i] + R[3 * i + j];
    q[k] = R[3 * k + i] + R[3 * i + k];
    const double half = 0.5 * std::sqrt(q[i]);  // the quaternion's own entry
    double vector[3], scalar = s[i] / (4 * half);
    for (int r = 0; r < 3; r++) vector[r] = q[r] / (4 * half);
    if (scalar < 0) {
        scalar = -scalar;
        for (double& x : vector) x = -x;
    }
    const double length = std::sqrt(dot3(vector, vector));
    const double f = 2 * std::atan2(length, scalar) / length;
    for (int r = 0; r < 3; r++) w[r] = f * vector[r];
}

// Jl^-1(w), the inverse of the left Jacobian: log(exp(a) R) = w + Jl^-1(w) a for small a.
inline void inverse_left_jacobian(const double* w, double* out) {
    const double t2 = dot3(w, w);
    double c;  // (1 - (t/2) cot(t/2)) / t^2
    if (t2 < 1e-3)
        c = 1. / 12 * (1 + t2 / 60 * (1 + t2 / 42 * (1 + t2 / 40)));
    else {
        const double half = 0.5 * std::sqrt(t2);
        c = (1 - half * std::cos(half) / std::sin(half)) / t2;
    }
    const double x = w[0], y = w[1], z = w[2];
    out[0] = 1 - c * (y * y + z * z);
    out[1] = 0.5 * z + c * x * y;
    out[2] = -0.5 * y + c * x * z;
    out[3] = -0.5 * z + c * x * y;
    out[4] = 1 - c * (x * x + z * z);
    out[5] = 0.5 * x + c * y * z;
    out[6] = 0.5 * y + c * x * z;
    out[7] = -0.5 * x + c * y * z;
    out[8] = 1 - c * (x * x + y * y);
}

}  // namespace coopqp
