// Each level's answer against the program itself, as coopqp.solver.Verifier does it.
//
// The rows are those of the Jacobians, the tasks and the limits, never the factors that the answer
// came from. Multipliers of loops and decided rows are found anew from the gradient; the factors
// help to find them, but what is judged is what is left of the gradient, in joint space.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "hierarchy.hpp"
#include "least_distance.hpp"
#include "loops.hpp"
#include "rows.hpp"

namespace coopqp {

constexpr int MOST_PASSES = 4;       // multipliers are refined until the certificate is good
constexpr double ROUNDING = 1e-4;    // most that rounding excuses, as coopqp.solver
constexpr double EPSILON = 2.220446049250313e-16;
constexpr double SCALE_WEIGHT = 1e3;

struct Outcome {
    Status status;
    double pull;  // LaterLevel.pull, or the sum of the hard rows' multipliers
};

class Check {
  public:
    Check(const Model& model, const Rows& rows, const Loops& loops, Hierarchy& hierarchy,
          const Settings& settings, const std::vector<Level>& levels,
          const std::vector<std::vector<int>>& kept, Arena& arena)
        : m_(model), rows_(rows), loops_(loops), hierarchy_(hierarchy), s_(settings),
          levels_(levels), kept_(kept), t_(arena.take(rows.stride())), g_(arena.take(rows.stride())),
          box_(arena.take(rows.stride())), moved_(arena.take(rows.stride())),
          y_(arena.take(std::size_t(hierarchy.width()))),
          lambda_(arena.take(std::size_t(hierarchy.width()))), loop_y_(std::size_t(6 * std::max(model.loops(), 1))),
          z_(std::size_t(settings.inequalities)), slack_(std::size_t(settings.inequalities)),
          step_(std::size_t(hierarchy.width())) {}

    // Largest residuals since the beginning, for who wants to know.
    double worst_primal = 0.0, worst_dual = 0.0;

    void aim(const double* b) { b_ = b; }

    // Judge v, which is clipped to its bounds on the way.
    //   first: how many coordinates of the hierarchy were decided when the level could choose.
    //   d: damping. before: answer of the levels before.
    Outcome judge(int l, int first, double d, double* v, const double* before,
                  const LeastDistance& nearest, const double* lb, const double* ub,
                  const double* G, const std::vector<double>& h) {
        const double mu = std::min(d, SCALE_WEIGHT);
        const double overrun = clip(v, lb, ub);
        double above = 0.0, V[6];
        const int p = s_.inequalities;
        for (int i = 0; i < p; i++) {
            const std::size_t at = std::size_t(i);
            slack_[at] = h[at] - dot(G + at * rows_.stride(), v, m_.blocks);
            if (slack_[at] < 0.0) above += slack_[at] * slack_[at];
        }
        above = std::sqrt(above);
        rows_.object_twist(v, V);
        const double gap = std::sqrt(loop_gap(v) + decided_gap(l, v, before, V));
        gradient(l, d, v, V, nearest, G);
        double off = 0.0;
        Outcome outcome{Status::Optimal, 0.0};
        std::fill(loop_y_.begin(), loop_y_.end(), 0.0);
        clear(lambda_, hierarchy_.blocks());
        for (int pass = 0; pass < MOST_PASSES; pass++) {
            reduce(g_);
            if (pass == 0 && l > 0) {
                outcome.pull = pull(l, first, d, v);
                reduce(g_);
            }
            balance_decided(first);
            loops_.balance(g_, loop_y_.data());
            off = distance(v, lb, ub, mu, nearest.active > 0);
            if (off <= s_.budget.accuracy) break;
        }
        if (l == 0)
            for (int i = 0; i < levels_[0].hard; i++) outcome.pull += std::fabs(lambda_[i]);
        off += idle(mu);
        worst_primal = std::max(worst_primal, std::max(gap, std::max(overrun, above)));
        worst_dual = std::max(worst_dual, off);
        if (!(gap + off + above + overrun < std::numeric_limits<double>::infinity()))
            outcome.status = Status::NotFinite;
        else if (!(overrun <= s_.budget.bound && above <= s_.budget.bound))
            outcome.status = Status::Bound;
        else if (!(gap <= s_.budget.equality))
            outcome.status = Status::Equality;
        else if (!(off <= s_.budget.accuracy) &&
                 !(off <= s_.budget.accuracy + rounding(l, first, d, v, G) / mu))
            outcome.status = Status::Inaccurate;
        return outcome;
    }

  private:
    double clip(double* v, const double* lb, const double* ub) const {
        v4* x = lanes(v);
        const v4 *lo = lanes(lb), *hi = lanes(ub);
        v4 squares = v4{};
        for (int b = 0; b < m_.blocks; b++) {
            const v4 inside = smaller(larger(x[b], lo[b]), hi[b]), over = x[b] - inside;
            squares += over * over;
            x[b] = inside;
        }
        return std::sqrt(sum(squares));
    }

    double loop_gap(const double* v) const {
        if (m_.loops() < 1) return 0.0;
        double V_0[6], V_i[6], gap2 = 0.0;
        std::size_t at = 0;
        rows_.twist(0, v, V_0);
        for (int i = 1; i < m_.holding; i++) {
            rows_.twist(i, v, V_i);
            for (int r : kept_[std::size_t(i - 1)]) {
                const double off = V_i[r] - V_0[r] - b_[at++];
                gap2 += off * off;
            }
        }
        return gap2;
    }

    // What the level moves of what was decided before it.
    double decided_gap(int l, const double* v, const double* before, const double* V) const {
        double gap2 = 0.0, V_moved[6];
        for (int s = 0; l == 0 && s < levels_[0].hard; s++) {
            const double off =
                rows_.times(levels_[0], s, v, V) - levels_[0].wanted[std::size_t(s)];
            gap2 += off * off;
        }
        if (l == 0) return gap2;
        for (int b = 0; b < m_.blocks; b++) lanes(moved_)[b] = lanes(v)[b] - lanes(before)[b];
        rows_.object_twist(moved_, V_moved);
        for (int k = 0; k < l; k++)
            for (int s = 0; s < levels_[std::size_t(k)].rows; s++) {
                const double off = rows_.times(levels_[std::size_t(k)], s, moved_, V_moved);
                gap2 += off * off;
            }
        return gap2;
    }

    // g = the level's gradient, with what active limits push; box_ has the part of bounds on v.
    void gradient(int l, double d, const double* v, const double* V, const LeastDistance& nearest,
                  const double* G) {
        const Level& level = levels_[std::size_t(l)];
        const double curvature = d + level.joint_weight;
        double tau[6] = {0, 0, 0, 0, 0, 0};
        for (int b = 0; b < m_.blocks; b++) lanes(g_)[b] = lanes(v)[b] * curvature;
        if (level.joint_weight > 0.0) add(g_, level.wish, -1.0, m_.blocks);
        for (int s = level.hard; s < level.rows; s++) {
            const std::size_t i = std::size_t(s);
            const double missed = rows_.times(level, s, v, V) - level.wanted[i];
            rows_.pull_row(level, s, level.weight[i] * missed, tau, g_);
        }
        rows_.pull_object(tau, g_);
        clear(box_, m_.blocks);
        std::fill(z_.begin(), z_.end(), 0.0);
        const int n = m_.blocks * LANES;
        for (int i = 0; i < nearest.active; i++) {
            const int row = nearest.row(i);
            if (row < n)
                box_[row] = nearest.multiplier(i);
            else {
                z_[std::size_t(row - n)] = nearest.multiplier(i);
                add(g_, G + std::size_t(row - n) * rows_.stride(), nearest.multiplier(i),
                    m_.blocks);
            }
        }
        add(g_, box_, 1.0, m_.blocks);
    }

    // y = U' Z' x
    void reduce(const double* x) {
        clear(y_, hierarchy_.blocks());
        for (int z = 0; z < loops_.free; z++)
            add(y_, hierarchy_.U(z), dot(loops_.Z + std::size_t(z) * rows_.stride(), x, m_.blocks),
                hierarchy_.blocks());
    }

    // Multipliers of the rows decided before; what they push is added to g.
    void balance_decided(int first) {
        if (first == 0) return;
        double tau[6] = {0, 0, 0, 0, 0, 0};
        for (int k = first; k-- > 0;) {
            double rest = -y_[k];
            for (int j = k + 1; j < first; j++)
                rest -= hierarchy_.row(hierarchy_.pivot_row(j))[k] * step_[std::size_t(j)];
            step_[std::size_t(k)] = rest / hierarchy_.row(hierarchy_.pivot_row(k))[k];
        }
        for (int k = 0; k < first; k++) {
            int at;
            const int s = own_row(hierarchy_.pivot_row(k), at);
            rows_.pull_row(levels_[std::size_t(at)], s, step_[std::size_t(k)], tau, g_);
            lambda_[k] += step_[std::size_t(k)];
        }
        rows_.pull_object(tau, g_);
    }

    // LaterLevel.pull: how much the level pulls at the task rows decided before it, by how fast
    // these turn. Damping is left out, or it would feed itself.
    double pull(int l, int first, double d, const double* v) {
        double lever = 0.0, sum = 0.0;
        for (int k = 0; k < l; k++)
            for (double of_row : levels_[std::size_t(k)].lever) lever = std::max(lever, of_row);
        if (lever == 0.0 || first == 0) return 0.0;
        copy(lambda_, y_, hierarchy_.blocks());
        reduce(v);
        for (int k = 0; k < first; k++) lambda_[k] -= d * y_[k];
        for (int k = first; k < hierarchy_.width(); k++) lambda_[k] = 0.0;
        for (int s = 0; s < hierarchy_.singular(); s++) {
            const double sigma = hierarchy_.sigma(s);
            if (sigma > NOISE)
                sum += std::fabs(dot(hierarchy_.direction(s), lambda_, hierarchy_.blocks())) /
                       (sigma * sigma);
        }
        clear(lambda_, hierarchy_.blocks());
        return lever * sum;
    }

    // Norm of a projected gradient step, an estimate of |v - v*|. g has the bounds' part in it.
    double distance(const double* v, const double* lb, const double* ub, double mu, bool active) {
        const v4 *g = lanes(g_), *box = lanes(box_), *x = lanes(v);
        v4 squares = v4{};
        if (!active) {
            for (int b = 0; b < m_.blocks; b++) squares += g[b] * g[b];
            const double free = std::sqrt(sum(squares)) / mu;
            if (free <= s_.budget.accuracy) return free;
            squares = v4{};
        }
        const v4 *lo = lanes(lb), *hi = lanes(ub);
        for (int b = 0; b < m_.blocks; b++) {
            const v4 step = x[b] - (g[b] - box[b]) / mu;
            const v4 off = x[b] - smaller(larger(step, lo[b]), hi[b]);
            squares += off * off;
        }
        return std::sqrt(sum(squares));
    }

    // How far the inequalities' multipliers are from belonging to active rows only.
    double idle(double mu) const {
        double squares = 0.0;
        for (std::size_t i = 0; i < z_.size(); i++) {
            const double off =
                std::max(std::min(slack_[i], z_[i] / mu), -std::fabs(z_[i]));
            squares += off * off;
        }
        return std::sqrt(squares);
    }

    // What the last digits of the terms that cancel in the gradient amount to, times mu.
    double rounding(int l, int first, double d, const double* v, const double* G) {
        const Level& level = levels_[std::size_t(l)];
        double* size = moved_;
        for (int b = 0; b < m_.blocks; b++) {
            lanes(size)[b] = larger(lanes(v)[b], -lanes(v)[b]) * (d + level.joint_weight);
            if (level.joint_weight > 0.0)
                lanes(size)[b] += larger(lanes(level.wish)[b], -lanes(level.wish)[b]);
        }
        for (int s = level.hard; s < level.rows; s++) {
            dense(level, s);
            double moved = std::fabs(level.wanted[std::size_t(s)]);
            for (int i = 0; i < m_.blocks * LANES; i++) moved += std::fabs(t_[i] * v[i]);
            grow(size, level.weight[std::size_t(s)] * moved, t_);
        }
        for (int k = 0; k < first; k++) {
            int at;
            const int s = own_row(hierarchy_.pivot_row(k), at);
            dense(levels_[std::size_t(at)], s);
            grow(size, lambda_[k], t_);
        }
        std::size_t at = 0;
        for (int i = 1; i < m_.holding; i++)
            for (int r : kept_[std::size_t(i - 1)]) {
                const double by = loop_y_[at++];
                double unit[6] = {0, 0, 0, 0, 0, 0};
                unit[r] = 1.0;
                clear(t_, m_.blocks);
                rows_.pull(i, unit, 1.0, t_);
                rows_.pull(0, unit, -1.0, t_);
                grow(size, by, t_);
            }
        for (std::size_t i = 0; i < z_.size(); i++) grow(size, z_[i], G + i * rows_.stride());
        return std::min(EPSILON * std::sqrt(dot(size, size, m_.blocks)),
                        ROUNDING * std::min(d, SCALE_WEIGHT));
    }

    void grow(double* size, double by, const double* row) const {
        for (int i = 0; i < m_.blocks * LANES; i++) size[i] += std::fabs(by * row[i]);
    }

    // A task row over all joints, into t_.
    void dense(const Level& level, int s) {
        double tau[6] = {0, 0, 0, 0, 0, 0};
        clear(t_, m_.blocks);
        rows_.pull_row(level, s, 1.0, tau, t_);
        rows_.pull_object(tau, t_);
    }

    // Which level a row of the hierarchy belongs to, and which of its rows it is.
    int own_row(int s, int& level) const {
        level = 0;
        while (s >= levels_[std::size_t(level)].rows) s -= levels_[std::size_t(level++)].rows;
        return s;
    }

    const Model& m_;
    const Rows& rows_;
    const Loops& loops_;
    Hierarchy& hierarchy_;
    const Settings& s_;
    const std::vector<Level>& levels_;
    const std::vector<std::vector<int>>& kept_;
    const double* b_ = nullptr;
    double *t_, *g_, *box_, *moved_, *y_, *lambda_;
    std::vector<double> loop_y_, z_, slack_;
    std::vector<double> step_;
};

}  // namespace coopqp
