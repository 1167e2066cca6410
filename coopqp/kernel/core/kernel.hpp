// One verified tick: kinematics, loops, levels, the look ahead.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "faults.hpp"
#include "hierarchy.hpp"
#include "least_distance.hpp"
#include "loops.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "small.hpp"

namespace coopqp {

constexpr double INSIDE = 1e-12;            // overrun of a limit that is left as it is [rad/s]
constexpr double OUTSIDE = 1e-9;            // as coopqp.limit.ROUNDING [rad, m]
constexpr double MOST_HARD_DAMPING = 1.0;   // as coopqp.qp_law.law
constexpr double MOST_DAMPING = 1e4;

class Kernel {
  public:
    Kernel(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model,
           std::vector<std::vector<int>> kept, Settings settings, std::vector<Level> given)
        : arena_(std::move(arena)),
          m_(std::move(model)),
          s_(std::move(settings)),
          kept_(std::move(kept)),
          levels(std::move(given)),
          kinematics(*m_),
          ahead_(*m_),
          rows_(*m_),
          loops_(loops_of(*m_, kept_, *arena_)),
          hierarchy_(loops_->free, most_rows(), *arena_),
          nearest_(stride() + padded(s_.inequalities), loops_->free, *arena_),
          lb(arena_->take(std::size_t(stride()))),
          ub(arena_->take(std::size_t(stride()))),
          G(arena_->take(std::size_t(stride() * (s_.inequalities + 1)))),
          h(std::size_t(s_.inequalities)),
          check_(*m_, rows_, *loops_, hierarchy_, s_, levels, kept_, *arena_),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          v_(arena_->take(std::size_t(stride()))),
          before_(arena_->take(std::size_t(stride()))),
          last_(arena_->take(std::size_t(stride()))),
          t_(arena_->take(std::size_t(stride()))),
          W_(arena_->take(std::size_t(6 * hierarchy_.width()))),
          x_(arena_->take(std::size_t(hierarchy_.width()))),
          z_(arena_->take(std::size_t(hierarchy_.width()))),
          X_(arena_->take(std::size_t(loops_->free + 1) * std::size_t(hierarchy_.width()))),
          residual_(std::size_t(most_rows() + 1)),
          small_(most_rows() + 1, std::min(most_rows(), loops_->free) + 1),
          pulls_(levels.size()),
          q_after_(std::size_t(m_->n())) {}

    // Kinematics of q; what follows from them is written to the bound arrays.
    Status update(double t) {
        const double* q = bound.q;
        double size = t;
        for (int j = 0; j < m_->n(); j++) size += q[j] * q[j] + bound.v_last[j] * bound.v_last[j];
        if (!std::isfinite(size)) return Status::NotFinite;
        kinematics.place(q);
        kinematics.measure();
        kinematics.differentiate();
        std::copy(kinematics.p_WO, kinematics.p_WO + 3, bound.p_WO);
        std::copy(kinematics.R_WO, kinematics.R_WO + 9, bound.R_WO);
        std::copy(kinematics.loop_error.begin(), kinematics.loop_error.end(), bound.loop_error);
        for (std::size_t i = 0; i < kinematics.loop_error.size(); i++)
            bound.drift[i] = drift(int(i));
        std::copy(q, q + m_->n(), bound.q_seen);
        return Status::Optimal;
    }

    // Decide v from the kinematics, tasks and limits as they stand.
    Status solve() {
        for (int j = 0; j < m_->n(); j++) {
            const std::size_t i = std::size_t(j);
            if (bound.q[j] < s_.lower[i] - OUTSIDE || bound.q[j] > s_.upper[i] + OUTSIDE)
                return Status::Outside;
            last_[m_->joints[i].lane] = bound.v_last[j];
        }
        aim_loops();
        if (!fault(Fault::StaleFactor) && !loops_->factor()) return Status::Singular;
        if (fault(Fault::WrongDirection)) loops_->Z[0] += 1e-3;
        loops_->particular(b_.data(), v_);
        if (fault(Fault::WrongSide)) v_[0] += 1e-4;
        see_object();
        hierarchy_.begin();
        for (std::size_t l = 0; l < levels.size(); l++) {
            const Status status = solve_level(int(l));
            if (status != Status::Optimal) return status;
        }
        if (!within()) return Status::Opens;
        for (int j = 0; j < m_->n(); j++) bound.v[j] = v_[m_->joints[std::size_t(j)].lane];
        for (std::size_t l = 1; l < levels.size(); l++) bound.later_pulls[l - 1] = pulls_[l];
        if (levels[0].hard) bound.hard_pull[0] = pulls_[0];
        return Status::Optimal;
    }

    // For tests: e, J over the joints and rate of each row.
    std::vector<double> rows_of(int l) const { return rows_.listed(levels[std::size_t(l)], t_); }

    int stride() const { return m_->blocks * LANES; }
    const Model& model() const { return *m_; }
    const Settings& settings() const { return s_; }
    Check& check() { return check_; }

  private:
    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> m_;
    Settings s_;
    std::vector<std::vector<int>> kept_;

  public:
    std::vector<Level> levels;
    Kinematics kinematics;
    Bound bound;

  private:
    static std::unique_ptr<Loops> loops_of(const Model& m,
                                           const std::vector<std::vector<int>>& kept,
                                           Arena& arena) {
        const int blocks = blocks_of(StagedLoops<2>::width(m));
        if (blocks > 16) throw std::invalid_argument("two arms have too many joints");
        if (blocks <= 2) return std::make_unique<StagedLoops<2>>(m, kept, arena);
        if (blocks == 3) return std::make_unique<StagedLoops<3>>(m, kept, arena);
        if (blocks == 4) return std::make_unique<StagedLoops<4>>(m, kept, arena);
        if (blocks <= 6) return std::make_unique<StagedLoops<6>>(m, kept, arena);
        return std::make_unique<StagedLoops<16>>(m, kept, arena);
    }

    int most_rows() const {
        int count = 0;
        for (const Level& level : levels) count += level.rows;
        return count;
    }

    // b = -kappa e with more gain where the loop budget is half used up, as LoopProbe.kappa.
    void aim_loops() {
        const double most = 1.0 / s_.dt;
        double kappa = s_.kappa, used = 0.0;
        for (int i = 0; i < m_->loops(); i++) {
            double e[6];
            for (int r = 0; r < 6; r++) e[r] = drift(6 * i + r);
            used = std::max(used, std::sqrt(dot3(e, e)) / s_.budget.loop_position);
            used = std::max(used, std::sqrt(dot3(e + 3, e + 3)) / s_.budget.loop_orientation);
        }
        if (kappa < most)
            kappa = std::max(kappa, std::min(std::max(2.0 * used - 1.0, 0.0), 1.0) * most);
        std::size_t at = 0;
        for (std::size_t i = 0; i < kept_.size(); i++)
            for (int r : kept_[i]) b_[at++] = -kappa * drift(6 * int(i) + r);
        check_.aim(b_.data());
    }

    double drift(int row) const { return kinematics.loop_error[std::size_t(row)] - bound.gap[row]; }

    // J_object Z. All arms that hold the object move it alike there, so arm 0 speaks for all.
    void see_object() {
        for (int r = 0; r < 6; r++) {
            double* w = W_ + r * hierarchy_.width();
            const double* J = m_->J_base(0, r);
            for (int z = 0; z < loops_->free; z++)
                w[z] = dot(J, loops_->Z + std::size_t(z * stride()), m_->base_blocks);
        }
    }

    Status solve_level(int l) {
        Level& level = levels[std::size_t(l)];
        const int before = hierarchy_.rows, decided = hierarchy_.decided;
        double V[6];
        for (int s = 0; s < level.rows; s++)
            level.wanted[std::size_t(s)] =
                level.rate[std::size_t(s)] - level.gain[std::size_t(s)] * level.e[std::size_t(s)];
        if (l > 0 && !hierarchy_.singular_values()) return Status::Singular;
        write_rows(level);
        if (fault(Fault::WrongRow) && level.rows) hierarchy_.row(hierarchy_.rows)[0] += 1e-3;
        hierarchy_.append(level.rows);
        const double d = s_.damping + extra_damping(l);
        copy(before_, v_, m_->blocks);
        rows_.object_twist(v_, V);
        rows_.times(level, 0, level.rows, v_, V, residual_.data());
        for (int s = 0; s < level.rows; s++)
            residual_[std::size_t(s)] = level.wanted[std::size_t(s)] - residual_[std::size_t(s)];
        // Hard rows first, exactly.
        clear(x_, hierarchy_.blocks());
        for (int s = 0; s < level.hard; s++) {
            if (int(hierarchy_.decided) <= s || hierarchy_.pivot_row(s) != s)
                return Status::Singular;
            double rest = residual_[std::size_t(s)];
            for (int k = 0; k < s; k++) rest -= hierarchy_.row(s)[k] * x_[k];
            x_[s] = rest / hierarchy_.row(s)[s];
        }
        const int first = decided + level.hard, own = hierarchy_.decided - first;
        const int soft = level.rows - level.hard;
        for (int s = level.hard; s < level.rows; s++)
            for (int k = 0; k < level.hard; k++)
                residual_[std::size_t(s)] -= hierarchy_.row(s)[k] * x_[k];
        if (level.hard) advance(x_);
        // Damping and joint objectives, in the coordinates that are free.
        const double curvature = d + level.joint_weight;
        const double* c = nullptr;
        if (l > 0 || level.joint_weight > 0.0) {
            for (int b = 0; b < m_->blocks; b++)
                lanes(t_)[b] = -lanes(v_)[b] * curvature;
            if (level.joint_weight > 0.0) add(t_, level.wish, 1.0, m_->blocks);
            reduce(t_, z_);
            c = z_;
        }
        small_.open(soft, own);
        for (int s = 0; s < soft; s++) {
            const double root = std::sqrt(level.weight[std::size_t(level.hard + s)]);
            const double* L = hierarchy_.row(before + level.hard + s) + first;
            for (int k = 0; k < own; k++) small_.A(s, k) = root * L[k];
            small_.b(s) = root * residual_[std::size_t(level.hard + s)];
        }
        small_.solve(curvature, c ? c + first : nullptr);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < own; k++) x_[first + k] = small_.x(k);
        if (c)
            for (int i = first + own; i < loops_->free; i++) x_[i] = c[i] / curvature;
        advance(x_);
        if (fault(Fault::WrongAnswer)) add(v_, loops_->Z, 1e-4, m_->blocks);
        Status status = bring_inside(first, own, curvature);
        if (status != Status::Optimal) return status;
        if (fault(Fault::WrongMultiplier)) nearest_.spoil();
        if (fault(Fault::ActiveForgotten)) nearest_.active = 0;
        const Outcome outcome = check_.judge(l, first, d, v_, before_, nearest_, lb, ub, G, h);
        pulls_[std::size_t(l)] = outcome.pull;
        return outcome.status;
    }

    // Rows of a level in coordinates of z, appended to those of the levels before.
    void write_rows(const Level& level) {
        const int blocks = hierarchy_.blocks();
        for (int s = 0; s < level.rows; s++) {
            double* row = hierarchy_.row(hierarchy_.rows + s);
            clear(row, blocks);
            if (level.twist[std::size_t(s)]) {
                for (int r = 0; r < 6; r++)
                    add(row, W_ + r * hierarchy_.width(), level.T[8 * s + r], blocks);
                continue;
            }
            const double* J = level.J + std::size_t(s * stride());
            for (int z = 0; z < loops_->free; z++)
                row[z] = dot(J, loops_->Z + std::size_t(z * stride()), m_->blocks);
        }
    }

    // What a step needs beside the damping of every tick, coopqp.qp_law.equations.step_damping.
    double extra_damping(int l) const {
        const Level& level = levels[std::size_t(l)];
        const double share = s_.error_damping * s_.dt;
        double bend = 0.0, V[6];
        bool twisted = false;
        for (int s = level.hard; s < level.rows; s++) {
            const std::size_t i = std::size_t(s);
            double size = level.gain[i] * std::fabs(level.e[i]);
            if (level.asks_velocity[i]) {
                if (!twisted) rows_.object_twist(last_, V);
                twisted = true;
                size = std::fabs(rows_.times(level, s, last_, V) - level.rate[i]);
            }
            bend += level.weight[i] * (size * level.lever[i]);
        }
        double extra = share * bend;
        if (l == 0 && level.hard)
            extra += std::min(share * s_.reach * bound.hard_pull[0], MOST_HARD_DAMPING);
        if (l > 0) extra += std::min(share * bound.later_pulls[l - 1], MOST_DAMPING);
        return extra;
    }

    // v += Z U y
    void advance(const double* y) {
        for (int z = 0; z < loops_->free; z++)
            add(v_, loops_->Z + std::size_t(z * stride()),
                dot(hierarchy_.U(z), y, hierarchy_.blocks()), m_->blocks);
    }

    // y = U' Z' t
    void reduce(const double* t, double* y) {
        clear(y, hierarchy_.blocks());
        for (int z = 0; z < loops_->free; z++)
            add(y, hierarchy_.U(z), dot(loops_->Z + std::size_t(z * stride()), t, m_->blocks),
                hierarchy_.blocks());
    }

    // Change v by as little as limits ask for, in the metric of the level's cost.
    Status bring_inside(int first, int own, double curvature) {
        nearest_.active = 0;
        const int n = stride(), p = s_.inequalities;
        bool inside = true;
        const v4 *lo = lanes(lb), *hi = lanes(ub), *x = lanes(v_);
        v4 over = v4{};
        for (int b = 0; b < m_->blocks; b++) over = larger(over, larger(lo[b] - x[b], x[b] - hi[b]));
        for (int k = 0; k < LANES; k++) inside &= over[k] <= INSIDE;
        double* slack = nearest_.upper + n;
        for (int i = 0; i < p; i++) {
            slack[i] = h[std::size_t(i)] - dot(G + std::size_t(i) * std::size_t(n), v_, m_->blocks);
            inside &= slack[i] >= -INSIDE;
        }
        if (inside || fault(Fault::LimitsForgotten)) return Status::Optimal;
        for (int b = 0; b < m_->blocks; b++) {
            lanes(nearest_.lower)[b] = lo[b] - x[b];
            lanes(nearest_.upper)[b] = hi[b] - x[b];
        }
        for (int i = 0; i < p; i++) nearest_.lower[n + i] = -1e300;
        const int K = loops_->free - first;
        const double scale = 1.0 / std::sqrt(curvature);
        for (int a = 0; a < K; a++) clear(nearest_.column(a), nearest_.stride() / LANES);
        for (int z = 0; z < loops_->free; z++) {
            double* X = X_ + z * hierarchy_.width();
            const double* u = hierarchy_.U(z) + first;
            small_.divide(u, X);
            for (int a = own; a < K; a++) X[a] = scale * u[a];
            for (int a = 0; a < K; a++)
                add(nearest_.column(a), loops_->Z + std::size_t(z * n), X[a], m_->blocks);
        }
        for (int i = 0; i < p; i++)
            for (int a = 0; a < K; a++)
                nearest_.column(a)[n + i] = dot(G + std::size_t(i) * std::size_t(n),
                                                nearest_.column(a), m_->blocks);
        const Status status = nearest_.solve(K);
        if (status != Status::Optimal) return status;
        for (int a = 0; a < K; a++) add(v_, nearest_.column(a), nearest_.u[a], m_->blocks);
        return Status::Optimal;
    }

    // Whether the step leaves the loops within their budget, as LoopProbe.within.
    bool within() {
        if (m_->loops() < 1) return true;
        double error = 0.0, speed = 0.0;
        for (int i = 0; i < 6 * m_->loops(); i++) error += drift(i) * drift(i);
        error = 2.0 * std::sqrt(error);
        speed = dot(v_, v_, m_->blocks);
        if (fits(error, s_.steepest * speed)) return true;
        double opened = 0.0;
        for (int i = 0; i < m_->loops(); i++) {
            double by = 0.0;
            for (int j = 0; j < m_->n(); j++) {
                const double v = v_[m_->joints[std::size_t(j)].lane];
                by += s_.second_order[std::size_t(i * m_->n() + j)] * v * v;
            }
            opened = std::max(opened, by);
        }
        return fits(error, opened) || look();
    }

    bool fits(double error, double opened) const {
        return error + s_.reach * opened <= s_.budget.loop_position &&
               error + opened <= s_.budget.loop_orientation;
    }

    bool look() {
        for (int j = 0; j < m_->n(); j++)
            q_after_[std::size_t(j)] =
                bound.q[j] + s_.dt * v_[m_->joints[std::size_t(j)].lane];
        ahead_.place(q_after_.data());
        ahead_.measure();
        for (int i = 0; i < m_->loops(); i++) {
            double e[6];
            for (int r = 0; r < 6; r++)
                e[r] = ahead_.loop_error[std::size_t(6 * i + r)] - bound.gap[6 * i + r];
            if (!(std::sqrt(dot3(e, e)) <= s_.budget.loop_position &&
                  std::sqrt(dot3(e + 3, e + 3)) <= s_.budget.loop_orientation))
                return false;
        }
        return true;
    }

    Kinematics ahead_;
    Rows rows_;
    std::unique_ptr<Loops> loops_;
    Hierarchy hierarchy_;
    LeastDistance nearest_;

  public:
    double *lb, *ub;        // in lanes
    double* G;              // (p, lanes)
    std::vector<double> h;

  private:
    Check check_;
    std::vector<double> b_;
    double *v_, *before_, *last_, *t_, *W_, *x_, *z_, *X_;
    std::vector<double> residual_;
    SmallLeastSquares small_;
    std::vector<double> pulls_;
    std::vector<double> q_after_;
};

}  // namespace coopqp
