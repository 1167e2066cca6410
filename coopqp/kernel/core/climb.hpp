// The gradient of the manipulability with the loops closed; formulas and letters are those of
// tasks/manipulability.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "model.hpp"
#include "rotation.hpp"
#include "shared.hpp"

namespace coopqp {

class Climb {
  public:
    // Memory for a robot, once.
    void open(const Model& m, Arena& arena) {
        blocks_ = m.blocks;
        const std::size_t rows = 6 * m.arms.size();
        J_ = arena.take(rows * stride());
        C_ = arena.take(rows * stride());
        pull_ = arena.take(rows * stride());
        free_ = arena.take(3 * stride());
        G_ = arena.take(3 * stride());
        gradient_ = arena.take(stride());
        A_.resize(rows * rows);  // of all loops, open ones too
        X_.resize(3 * rows);
    }

    // grad m / max(m_0, m / LARGE_PHI) in lanes, zero where it cannot be computed.
    const double* slope(const Model& m, const std::vector<int>& axes, double m_0) {
        clear(gradient_, blocks_);
        const double size = gradient(m, axes);
        const double factor = 1.0 / std::max(m_0, size / LARGE_PHI);
        for (int b = 0; b < blocks_; b++) lanes(gradient_)[b] *= factor;
        return gradient_;
    }

  private:
    std::size_t stride() const { return std::size_t(blocks_) * LANES; }
    double* J(std::size_t arm, std::size_t r) { return J_ + (6 * arm + r) * stride(); }
    double* C(std::size_t row) { return C_ + row * stride(); }
    double* pull(std::size_t arm, std::size_t r) { return pull_ + (6 * arm + r) * stride(); }

    // m, whose gradient is written.
    double gradient(const Model& m, const std::vector<int>& axes) {
        const std::size_t loops = 6 * (m.arms.size() - 1), k = axes.size();
        gather(m);
        for (std::size_t i = 0; i < loops; i++)
            for (std::size_t j = 0; j <= i; j++) A_[i * loops + j] = dot(C(i), C(j), blocks_);
        if (!factor(A_.data(), loops)) return 0.0;
        for (std::size_t a = 0; a < k; a++) project(m, axes, a, loops);
        double B[9];
        for (std::size_t a = 0; a < k; a++)
            for (std::size_t b = 0; b <= a; b++)
                B[a * k + b] = dot(free_ + a * stride(), free_ + b * stride(), blocks_);
        if (!factor(B, k)) return 0.0;
        double size = 1.0;
        for (std::size_t a = 0; a < k; a++) size *= B[a * k + a];
        for (std::size_t a = 0; a < k; a++) {  // G' = (J P J')^-1 J P
            double unit[3] = {0.0, 0.0, 0.0};
            unit[a] = 1.0;
            solve(B, k, unit);
            clear(G_ + a * stride(), blocks_);
            for (std::size_t b = 0; b < k; b++)
                add(G_ + a * stride(), free_ + b * stride(), unit[b], blocks_);
        }
        mix(m, axes, size);
        for (std::size_t i = 0; i < m.arms.size(); i++) along(m, i);
        return size;
    }

    // The arms' Jacobians and their differences, over all lanes.
    void gather(const Model& m) {
        for (std::size_t i = 0; i < m.arms.size(); i++) {
            const Arm& arm = m.arms[i];
            for (std::size_t r = 0; r < 6; r++) {
                clear(J(i, r), blocks_);
                copy(J(i, r), m.J_base(int(i), int(r)), m.base_blocks);
                if (arm.own_blocks) copy(J(i, r) + arm.first, m.J_own(int(i), int(r)), arm.own_blocks);
                if (i == 0) continue;
                copy(C(6 * (i - 1) + r), J(i, r), blocks_);
                add(C(6 * (i - 1) + r), J(0, r), -1.0, blocks_);
            }
        }
    }

    // Row a of the object's Jacobian: X = (C C')^-1 C J', and what is left of it, J P.
    void project(const Model& m, const std::vector<int>& axes, std::size_t a, std::size_t loops) {
        double *left = free_ + a * stride(), *x = &X_[a * loops];
        const std::size_t r = std::size_t(axes[a]);
        clear(left, blocks_);
        for (std::size_t i = 0; i < m.arms.size(); i++)
            add(left, J(i, r), m.arms[i].alpha, blocks_);
        for (std::size_t i = 0; i < loops; i++) x[i] = dot(C(i), left, blocks_);
        solve(A_.data(), loops, x);
        for (std::size_t i = 0; i < loops; i++) add(left, C(i), -x[i], blocks_);
    }

    // m (mixture of the arms' rows)' G', shape (6 N, lanes).
    void mix(const Model& m, const std::vector<int>& axes, double size) {
        const std::size_t loops = 6 * (m.arms.size() - 1);
        for (std::size_t i = 0; i < m.arms.size(); i++)
            for (std::size_t r = 0; r < 6; r++) {
                clear(pull(i, r), blocks_);
                for (std::size_t a = 0; a < axes.size(); a++) {
                    double share = r == std::size_t(axes[a]) ? m.arms[i].alpha : 0.0;
                    for (std::size_t l = 0; i == 0 && l < loops; l += 6) share += X_[a * loops + l + r];
                    if (i > 0) share -= X_[a * loops + 6 * (i - 1) + r];
                    add(pull(i, r), G_ + a * stride(), size * share, blocks_);
                }
            }
    }

    // What the columns of one arm change by, from its tip to its base and back.
    void along(const Model& m, std::size_t i) {
        const Arm& arm = m.arms[i];
        const std::size_t count = arm.base.size() + arm.own.size();
        const auto lane_of = [&](std::size_t at) {
            const int j = at < arm.base.size() ? arm.base[at] : arm.own[at - arm.base.size()];
            return std::size_t(m.joints[std::size_t(j)].lane);
        };
        const auto column = [&](double* rows, std::size_t lane, double* out) {
            for (std::size_t r = 0; r < 3; r++) out[r] = rows[r * stride() + lane];
        };
        double sum[3] = {0.0, 0.0, 0.0}, v[3], w[3], g[3], h[3], x[3];
        for (std::size_t at = count; at-- > 0;) {  // this joint and those after it
            const std::size_t lane = lane_of(at);
            column(J(i, 0), lane, v), column(J(i, 3), lane, w);
            column(pull(i, 0), lane, g), column(pull(i, 3), lane, h);
            cross3(v, g, x);
            for (int r = 0; r < 3; r++) sum[r] += x[r];
            cross3(w, h, x);
            for (int r = 0; r < 3; r++) sum[r] += x[r];
            gradient_[lane] += dot3(w, sum);
        }
        std::fill(sum, sum + 3, 0.0);
        for (std::size_t at = 0; at < count; at++) {  // those before it
            const std::size_t lane = lane_of(at);
            column(J(i, 0), lane, v), column(J(i, 3), lane, w), column(pull(i, 0), lane, g);
            gradient_[lane] += dot3(v, sum);
            cross3(g, w, x);
            for (int r = 0; r < 3; r++) sum[r] += x[r];
        }
    }

    // Cholesky's factor of A, whose lower half is given, with a little more on its diagonal; false
    // where it is not positive definite.
    static bool factor(double* A, std::size_t n) {
        double trace = 0.0;
        for (std::size_t i = 0; i < n; i++) trace += A[i * n + i];
        for (std::size_t i = 0; i < n; i++) A[i * n + i] += REGULAR * trace;
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j <= i; j++) {
                double rest = A[i * n + j];
                for (std::size_t l = 0; l < j; l++) rest -= A[i * n + l] * A[j * n + l];
                if (i == j && !(rest > 0.0)) return false;
                A[i * n + j] = i == j ? std::sqrt(rest) : rest / A[j * n + j];
            }
        return true;
    }

    // x becomes A^-1 x, with A's factor.
    static void solve(const double* L, std::size_t n, double* x) {
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = 0; j < i; j++) x[i] -= L[i * n + j] * x[j];
            x[i] /= L[i * n + i];
        }
        for (std::size_t i = n; i-- > 0;) {
            for (std::size_t j = i + 1; j < n; j++) x[i] -= L[j * n + i] * x[j];
            x[i] /= L[i * n + i];
        }
    }

    int blocks_ = 0;
    double *J_ = nullptr, *C_ = nullptr, *pull_ = nullptr, *free_ = nullptr, *G_ = nullptr;
    double* gradient_ = nullptr;
    std::vector<double> A_, X_;
};

}  // namespace coopqp
