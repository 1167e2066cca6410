// Laws in closed form, eq. (32)-(34): v = Z + A^# (b - A Z), A the task rows above the loop rows.
//
// A^# = W A' (A W W A' + damping^2 I)^-1. Reflections from the right bring [A W, damping I] to a
// triangle L, so that v - Z is W times the first n numbers of Q L^-1 (b - A Z).
#pragma once
#include <cmath>
#include <vector>

#include "kernel.hpp"

namespace coopqp {

class ResolvedRate {
  public:
    // damping [m/rad]. weighted: joints that move towards a limit move less (Chan and Dubey 1995).
    ResolvedRate(Kernel& kernel, double damping, bool weighted)
        : kernel_(kernel), damping_(damping), weighted_(weighted), n_(std::size_t(kernel.model().n())) {
        rows_ = std::size_t(kernel.levels[0].rows);
        for (const auto& loop : kernel.kept()) rows_ += loop.size();
        width_ = n_ + (damping > 0.0 ? rows_ : 0);
        A_.resize(rows_ * width_);
        for (auto* each : {&b_, &beta_, &y_}) each->resize(rows_);
        x_.resize(width_);
        inverse_.resize(rows_ * rows_);
        shrink_.assign(n_, 1.0);
    }

    // Write v; false where rows are nearly dependent, so that ranks have to be decided.
    //   J_ext: of State. share: of the second level's wish in Z.
    bool solve(const double* J_ext, double share) {
        fill(J_ext);
        const auto& joints = kernel_.model().joints;
        double* v = kernel_.bound.v;
        for (std::size_t j = 0; j < n_; j++)
            v[j] = share > 0.0 ? share * kernel_.levels[1].wish[joints[j].lane] : 0.0;
        for (std::size_t s = 0; s < rows_; s++)
            for (std::size_t j = 0; j < n_; j++) b_[s] -= row(s)[j] * v[j];
        if (weighted_) weigh();
        if (rows_ > width_ || !factor()) return false;
        for (std::size_t j = 0; j < n_; j++) v[j] += shrink_[j] * x_[j];
        for (std::size_t j = 0; j < n_; j++)
            if (!std::isfinite(v[j])) return false;
        return true;
    }

  private:
    // Condition number from which on ranks are Python's to decide, which does it at 1e8 and 1e10.
    static constexpr double DEPENDENT = 1e6;
    static constexpr double NEAREST = 1e-4;  // as coopqp.controllers.weighted_least_norm
    static constexpr double LIMITLESS = 1e299;

    double* row(std::size_t s) { return &A_[s * width_]; }

    void fill(const double* J_ext) {
        Level& level = kernel_.levels[0];
        level.want();
        const std::vector<double> listed = kernel_.rows_of(0);
        std::fill(A_.begin(), A_.end(), 0.0);
        std::size_t s = 0;
        for (; s < std::size_t(level.rows); s++) {
            std::copy_n(&listed[s * (n_ + 2) + 1], n_, row(s));
            b_[s] = level.wanted[s];
        }
        for (std::size_t i = 0; i < kernel_.kept().size(); i++)
            for (int r : kernel_.kept()[i]) {
                const std::size_t of = 6 * i + std::size_t(r);
                std::copy_n(J_ext + (6 + of) * n_, n_, row(s));
                b_[s++] = -kernel_.settings().kappa * kernel_.bound.drift[of];
            }
        for (s = 0; s < rows_ && damping_ > 0.0; s++) row(s)[n_ + s] = damping_;
    }

    void weigh() {
        const auto& settings = kernel_.settings();
        const double *q = kernel_.bound.q, *v = kernel_.bound.v_last;
        for (std::size_t j = 0; j < n_; j++) {
            const double l = settings.lower[j], u = settings.upper[j], range = u - l;
            if (!(range < LIMITLESS)) continue;
            const double at = std::min(std::max(q[j], l + NEAREST * range), u - NEAREST * range);
            const double off = 2.0 * at - u - l, far = (u - at) * (at - l);
            const double slope = range * range * off / (4.0 * far * far);
            shrink_[j] = v[j] * off >= 0.0 ? 1.0 / std::sqrt(1.0 + std::fabs(slope)) : 1.0;
            for (std::size_t s = 0; s < rows_; s++) row(s)[j] *= shrink_[j];
        }
    }

    // x of least norm with A x = b.
    bool factor() {
        double size2 = 0.0;
        for (std::size_t s = 0; s < rows_; s++) {
            double *h = row(s), left2 = 0.0;
            for (std::size_t k = 0; k < s; k++) {
                reflect(k, h);
                size2 += h[k] * h[k];
            }
            for (std::size_t j = s; j < width_; j++) left2 += h[j] * h[j];
            if (!(left2 > 0.0)) return false;
            const double pivot = h[s], onto = pivot > 0.0 ? -std::sqrt(left2) : std::sqrt(left2);
            y_[s] = onto;
            h[s] = pivot - onto;
            beta_[s] = -1.0 / (onto * h[s]);
            size2 += left2;
        }
        if (!(size2 * invert() < DEPENDENT * DEPENDENT)) return false;
        std::fill(x_.begin(), x_.end(), 0.0);
        for (std::size_t s = 0; s < rows_; s++)
            for (std::size_t k = 0; k <= s; k++) x_[s] += inverse_[s * rows_ + k] * b_[k];
        for (std::size_t s = rows_; s-- > 0;) reflect(s, x_.data());
        return true;
    }

    void reflect(std::size_t k, double* x) {
        const double* h = row(k);
        double along = 0.0;
        for (std::size_t j = k; j < width_; j++) along += h[j] * x[j];
        along *= beta_[k];
        for (std::size_t j = k; j < width_; j++) x[j] -= along * h[j];
    }

    // L^-1, of which the size squared is returned; y_ has the diagonal of L.
    double invert() {
        double size2 = 0.0;
        for (std::size_t s = 0; s < rows_; s++)
            for (std::size_t c = 0; c <= s; c++) {
                double x = s == c ? 1.0 : 0.0;
                for (std::size_t k = c; k < s; k++) x -= row(s)[k] * inverse_[k * rows_ + c];
                inverse_[s * rows_ + c] = x /= y_[s];
                size2 += x * x;
            }
        return size2;
    }

    Kernel& kernel_;
    double damping_;
    bool weighted_;
    std::size_t n_, rows_ = 0, width_ = 0;
    std::vector<double> A_, b_, beta_, y_, x_, inverse_, shrink_;
};

}  // namespace coopqp
