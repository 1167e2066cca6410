// Configurations with the loops closed, and tasks held, inside the joints' limits.
//
// A point off the manifold is brought back by Newton steps of least norm. At each step rows are
// orthogonalised by the largest that is left first and no more are taken than are independent in
// general, so that loops with too many rows, or with fewer at special poses, are closed as others.
// A joint that a step would drive through its limit stays there and the others do its part.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "kinematics.hpp"
#include "program.hpp"

namespace coopqp {

class Manifold {
  public:
    // Tasks are those of one level, at time t, of which no row is Python's; `rank`: of the loops.
    Manifold(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model,
             const std::vector<double>& kept, int rank, std::vector<Level> levels,
             std::vector<Primitive> primitives, double t, std::vector<double> lower,
             std::vector<double> upper)
        : lower_(std::move(lower)), upper_(std::move(upper)), arena_(std::move(arena)),
          m_(std::move(model)), k_(*m_), levels_(std::move(levels)), t_(t),
          blocks_(blocks_of(m_->n())) {
        program_.primitives = std::move(primitives);
        for (std::size_t i = 0; i < kept.size(); i++)
            if (kept[i] != 0.0) kept_.push_back(int(i));
        loops_ = int(kept.size());
        const int tasks = int(levels_[0].e.size());
        rank_ = std::min(rank, int(kept_.size())) + tasks;
        rows_ = int(kept_.size()) + tasks;
        for (const Primitive& p : program_.primitives)
            if (p.kind == Kind::Posture)
                for (std::size_t i = 0; i < p.rows.size(); i++)
                    levels_[0].J[(std::size_t(p.at) + i) * std::size_t(m_->blocks * LANES) +
                                 std::size_t(m_->joints[std::size_t(p.rows[i])].lane)] = 1.0;
        const auto size = std::size_t(blocks_ * LANES);
        J_ = arena_->take(std::size_t(rows_ + 1) * size);
        Q_ = arena_->take(std::size_t(rows_ + 1) * size);
        d_ = arena_->take(size);
        e_.resize(std::size_t(rows_ + 1));
        y_.resize(std::size_t(rows_ + 1));
        left_.resize(std::size_t(rows_ + 1));
        used_.resize(std::size_t(rows_ + 1));
        still_.resize(std::size_t(m_->n()));
    }

    int n() const { return m_->n(); }
    const Model& model() const { return *m_; }
    // As joints were when a configuration was last brought back.
    const Kinematics& kinematics() const { return k_; }

    // Bring q back with at most `steps` Newton steps, none longer than `longest`; joints that are
    // held stay (null: none are). After a short step that did well its Jacobian serves once more.
    bool project(double* q, const char* held, int steps,
                 double longest = std::numeric_limits<double>::infinity()) {
        look(q);
        double before = 0.0, moved = SHORT;
        for (int i = 0;; i++) {
            const double now = off();
            if (now <= CLOSED) return open() < OPEN && inside(q);
            if (i == steps) return false;
            const bool anew = !(moved < SHORT && now < WELL * before);
            if (anew) differentiate();
            moved = step(q, held, anew);
            if (!(moved <= longest)) return false;
            before = now;
            look(q);
        }
    }

    bool inside(const double* q) const {
        for (int j = 0; j < n(); j++)
            if (q[j] < lower_[std::size_t(j)] || q[j] > upper_[std::size_t(j)]) return false;
        return true;
    }

  private:
    static constexpr double CLOSED = 1e-9;   // of a kept row [m, rad]
    static constexpr double OPEN = 1e-6;     // of any row of the loops [m, rad]
    static constexpr double LEAST = 1e-5;    // share of the largest row below which none counts
    static constexpr double FARTHEST = 0.4;  // of a joint in a Newton step [rad, m]
    static constexpr double SHORT = 0.05;    // a step after which the Jacobian is much the same
    static constexpr double WELL = 0.1;      // share of the rows' errors that such a step leaves

    void look(const double* q) {
        k_.place(q);
        k_.measure();
        std::size_t at = 0;
        for (int r : kept_) e_[at++] = k_.loop_error[std::size_t(r)];
        if (levels_[0].e.empty()) return;
        program_.run(t_, k_, *m_, q, levels_);
        for (double x : levels_[0].e) e_[at++] = x;
    }

    double off() const {
        double most = 0.0;
        for (int r = 0; r < rows_; r++) {
            const double x = std::fabs(e_[std::size_t(r)]);
            if (!(x <= most)) most = x;  // NaN counts
        }
        return most;
    }

    double open() const {
        double most = 0.0;
        for (int r = 0; r < loops_; r++)
            most = std::max(most, std::fabs(k_.loop_error[std::size_t(r)]));
        return most;
    }

    double* row(int r) { return J_ + r * blocks_ * LANES; }

    // Rows over the joints, in their order.
    void differentiate() {
        k_.differentiate();
        const int width = blocks_ * LANES, loops = int(kept_.size());
        std::fill(J_, J_ + rows_ * width, 0.0);
        for (int s = 0; s < loops; s++) {
            const int arm = kept_[std::size_t(s)] / 6 + 1, r = kept_[std::size_t(s)] % 6;
            spread(arm, 1.0, r, row(s));
            spread(0, -1.0, r, row(s));
        }
        const Level& level = levels_[0];
        for (std::size_t i = 0; i < level.e.size(); i++) {
            double* to = row(loops + int(i));
            if (!level.twist[i]) {
                const double* J = level.J + i * std::size_t(m_->blocks * LANES);
                for (int j = 0; j < n(); j++) to[j] = J[m_->joints[std::size_t(j)].lane];
                continue;
            }
            for (std::size_t a = 0; a < m_->arms.size(); a++)
                if (m_->arms[a].alpha != 0.0)
                    for (int r = 0; r < 6; r++)
                        spread(int(a), m_->arms[a].alpha * level.T[8 * i + std::size_t(r)], r, to);
        }
    }

    // Add a row of an arm's Jacobian.
    void spread(int arm, double factor, int r, double* to) const {
        const Arm& a = m_->arms[std::size_t(arm)];
        const double* column = a.columns;
        for (const auto* joints : {&a.base, &a.own})
            for (int j : *joints) {
                to[j] += factor * column[r];
                column += TWIST;
            }
    }

    // One Newton step inside the limits, with the last Jacobian or anew; how far it goes, NaN where
    // rows leave none.
    double step(double* q, const char* held, bool anew) {
        constexpr double NONE = std::numeric_limits<double>::quiet_NaN();
        if (anew)
            for (int j = 0; j < n(); j++) still_[std::size_t(j)] = held ? held[j] : 0;
        for (int turn = 0; turn < 4; turn++) {
            if (anew || turn) found_ = orthogonalise();
            if (!found_) return NONE;
            solve();
            bool again = false;
            for (int j = 0; j < n(); j++) {
                const auto at = std::size_t(j);
                const bool out = (q[j] <= lower_[at] && d_[j] < 0.0) ||
                                 (q[j] >= upper_[at] && d_[j] > 0.0);
                if (!out || still_[at]) continue;
                still_[at] = 1;
                again = true;
            }
            if (!again) break;
        }
        double most = 0.0;
        for (int j = 0; j < n(); j++) most = std::max(most, std::fabs(d_[j]));
        if (!(most < 1e6)) return NONE;
        const double by = most > FARTHEST ? FARTHEST / most : 1.0;
        for (int j = 0; j < n(); j++) {
            const auto at = std::size_t(j);
            if (!still_[at]) q[j] = std::min(std::max(q[j] + by * d_[j], lower_[at]), upper_[at]);
        }
        return std::sqrt(dot(d_, d_, blocks_));
    }

    // Gram-Schmidt by the largest row left; L of J = L Q lies in left of the rows. Number of rows.
    int orthogonalise() {
        const int width = blocks_ * LANES;
        L_.assign(std::size_t(rows_ * rows_), 0.0);
        std::copy(J_, J_ + rows_ * width, Q_);  // those left over come after those in use
        for (int j = 0; j < n(); j++)
            if (still_[std::size_t(j)])
                for (int r = 0; r < rows_; r++) Q_[r * width + j] = 0.0;
        for (int r = 0; r < rows_; r++) {
            used_[std::size_t(r)] = r;
            left_[std::size_t(r)] = dot(Q_ + r * width, Q_ + r * width, blocks_);
        }
        double first = 0.0;
        for (int k = 0; k < rank_ && k < rows_; k++) {
            int best = k;
            for (int r = k + 1; r < rows_; r++)
                if (left_[std::size_t(r)] > left_[std::size_t(best)]) best = r;
            const double size = left_[std::size_t(best)];
            first = std::max(first, size);
            if (!(size > LEAST * LEAST * first) || size == 0.0) return k;
            swap(k, best);
            double* q = Q_ + k * width;
            const double length = std::sqrt(size);
            for (int b = 0; b < blocks_; b++) lanes(q)[b] = lanes(q)[b] / length;
            L_[std::size_t(k * rows_ + k)] = length;
            for (int r = k + 1; r < rows_; r++) {
                double* other = Q_ + r * width;
                const double along = dot(other, q, blocks_);
                add(other, q, -along, blocks_);
                L_[std::size_t(r * rows_ + k)] = along;
                left_[std::size_t(r)] = dot(other, other, blocks_);
            }
        }
        return std::min(rank_, rows_);
    }

    void swap(int a, int b) {
        if (a == b) return;
        const int width = blocks_ * LANES;
        std::swap_ranges(Q_ + a * width, Q_ + (a + 1) * width, Q_ + b * width);
        std::swap(used_[std::size_t(a)], used_[std::size_t(b)]);
        std::swap(left_[std::size_t(a)], left_[std::size_t(b)]);
        for (int k = 0; k < rows_; k++)
            std::swap(L_[std::size_t(a * rows_ + k)], L_[std::size_t(b * rows_ + k)]);
    }

    // d of least norm with J d = -e in the rows found.
    void solve() {
        for (int j = 0; j < blocks_ * LANES; j++) d_[j] = 0.0;
        for (int k = 0; k < found_; k++) {
            double rest = -e_[std::size_t(used_[std::size_t(k)])];
            for (int i = 0; i < k; i++) rest -= L_[std::size_t(k * rows_ + i)] * y_[std::size_t(i)];
            y_[std::size_t(k)] = rest / L_[std::size_t(k * rows_ + k)];
            add(d_, Q_ + k * blocks_ * LANES, y_[std::size_t(k)], blocks_);
        }
    }

    std::vector<double> lower_, upper_;
    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> m_;
    Kinematics k_;
    std::vector<Level> levels_;
    Program program_;
    double t_;
    int blocks_, loops_ = 0, rank_ = 0, rows_ = 0, found_ = 0;
    std::vector<int> kept_, used_;
    std::vector<double> e_, y_, left_, L_;
    std::vector<char> still_;
    double *J_ = nullptr, *Q_ = nullptr, *d_ = nullptr;
};

}  // namespace coopqp
