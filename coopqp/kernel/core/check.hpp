// Each level's answer against the program itself, as coopqp.solver.Verifier does it.
//
// The rows are those of the Jacobians, the tasks and the limits, never the factors that the answer
// came from; what is judged is what is left of the gradient, in joint space (multipliers.hpp).
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "constraints.hpp"
#include "multipliers.hpp"
#include "residuals.hpp"

namespace coopqp {

constexpr int MOST_PASSES = 4;       // multipliers are refined until the certificate is good
constexpr double FASTEST = 1e6;      // of joints without a limit, in proofs that there is no motion
// By which all constraints may give way and still clash: more than daqp lets them, or than rounding
// makes of them [rad/s].
constexpr double CLEARLY = 3.05e-7, CLOSELY = 1e-10;

struct Outcome {
    Status status;
    double pull;  // of a later level at those before, coopqp.qp_law.priorities
    double off;   // estimate of |v - v*|
    double gap;   // by how much rows that must hold do not, but for what levels before left
    double astray = 0.0;  // the part of off that comes from these rows
};

// Whether a share is at a bound, but for rounding.
inline bool at_bound(double share) { return share < LAST_DIGITS || share > 1.0 - LAST_DIGITS; }

class Check {
  public:
    Check(const Model& model, const Rows& rows, const Loops& loops, Hierarchy& hierarchy,
          Shares& shares, const Settings& settings, const std::vector<Level>& levels,
          const std::vector<std::vector<int>>& kept, Arena& arena)
        : m_(model), rows_(rows), hierarchy_(hierarchy), shares_(shares), s_(settings),
          levels_(levels), kept_(kept),
          moved_(arena.take(rows.stride())), of_arms_(arena.take(TWIST * model.arms.size())), V(arena.take(TWIST)),
          r_(model, rows, loops, hierarchy, shares, levels, arena),
          y_(model, rows, loops, hierarchy, levels, arena) {}

    // Largest residuals since the beginning, for who wants to know.
    double worst_primal = 0.0, worst_dual = 0.0;

    void aim(const double* b) { b_ = b; }

    // Judge v, which is clipped to its bounds on the way.
    //   first: how many coordinates of the hierarchy were decided when the level could choose.
    //   d: damping. before: answer of the levels before.
    Outcome judge(int l, int first, double d, double* v, const double* before,
                  Constraints& c) {
        // Hard tasks, damped less, decide what rows do, not all of v, where scaled ones come after.
        const bool rows_alone = std::size_t(l) + 1 < levels_.size() && levels_[std::size_t(l) + 1].rows;
        const double mu = std::min(rows_alone ? std::max(d, s_.damping) : d, SCALE_WEIGHT);
        const double over2 = clip(v, c.limits.lb, c.limits.ub);
        const double violation = std::sqrt(over2 + (l == 0 ? clip_shares() : 0.0));
        double above = 0.0;
        alignas(64) double V_before[TWIST];
        slack_.resize(c.limits.h.size());
        for (std::size_t at = 0; at < slack_.size(); at++) {
            slack_[at] = c.limits.h[at] - dot(c.limits.G + at * rows_.stride(), v, m_.blocks);
            if (slack_[at] < 0.0) above += slack_[at] * slack_[at];
        }
        exceeds_ = levels_[0].exact && l == 0 && over2 + above > LAST_DIGITS * LAST_DIGITS;
        above = std::sqrt(above);
        copy(V_before, V, 2);
        rows_.twists(v, of_arms_);
        rows_.mean(of_arms_, V);
        const double gap2 = decided_gap(l, v, before, V_before);
        const double gap = std::sqrt(gap2 + loop_gap(b_));
        double own = gap;
        if (l > 0 && gap > LAST_DIGITS) {  // what the loops lacked before is not this level's
            rows_.twists(moved_, of_arms_);
            own = std::sqrt(gap2 + loop_gap(nullptr));
        }
        gradient(l, d, v, c);
        double off = 0.0;
        Outcome outcome{Status::Optimal, 0.0, 0.0, own};
        if (l > 0) outcome.pull = y_.pull(l, first, d, v);
        for (int pass = 0; pass < MOST_PASSES; pass++) {
            y_.balance(first);
            off = distance(v, c.limits.lb, c.limits.ub, mu, c.nearest.active > 0);
            if (l == 0 && shares_.count()) off = std::sqrt(off * off + share_distance2(mu));
            if (off <= s_.budget.accuracy) break;
        }
        off += idle(mu);
        const double held = r_.distance(first, outcome.gap, v, c);
        const double astray = l == 0 ? std::max(held, unsure(v, c)) : held;
        worst_primal = std::max(worst_primal, std::max(gap, std::max(violation, above)));
        worst_dual = std::max(worst_dual, off);
        if (!(gap + off + astray + above + violation < std::numeric_limits<double>::infinity()))
            outcome.status = Status::NotFinite;
        else if (!(violation <= s_.budget.bound && above <= s_.budget.bound))
            outcome.status = Status::Bound;
        else if (!(gap <= s_.budget.equality))
            outcome.status = Status::Equality;
        else if (!(astray <= s_.budget.accuracy && off <= s_.budget.accuracy))
            outcome.status = Status::Inaccurate;
        outcome.off = off + astray;
        if (l == 0) find_firm();
        outcome.astray = astray;
        return outcome;
    }

    // What is left of the gradient over the joints, and over a share, of the answer judged last.
    const double* left() const { return y_.g; }
    double left_of_share(int k) const {
        return SCALE_WEIGHT * (shares_.share(k) - levels_[0].best_share(k)) - y_.at_share(k) +
               y_.of_shares[std::size_t(k)];
    }

    // Whether that is what the levels of least squares answer, QPLaw._holds_firmly.
    //   d: its damping. met: whether v_h is known to lack nothing.
    bool holds_firmly(double d, bool met) const {
        const Level& level = levels_[0];
        double all2 = 0.0, lacks2 = 0.0, least = std::numeric_limits<double>::infinity();
        for (int s = 0; s < level.exact; s++) {
            const double by = y_.of_exact(s), weight = level.weight[std::size_t(s)];
            all2 += by * by;
            if (s >= level.hard) continue;
            lacks2 += by * by / weight;
            least = std::min(least, weight);
        }
        if (level.shares && std::sqrt(all2) * FAST > ASIDE * SCALE_WEIGHT) return false;
        const double least_damping = LESS * level.most_weight() * s_.damping;
        return met || least_damping / d * std::sqrt(lacks2) <= MET * std::sqrt(least);
    }

    // Whether exact rows exceed limits by more than last digits, in the answer judged last: near others
    // that depend on them that may be far from the optimum.
    bool exceeds() const { return exceeds_; }

    // The least step after which the rows of the answer judged last hold.
    const double* restoring() const { return r_.step(); }

    // How much the answer judged last pulls at the loops.
    double loop_pull() const {
        double all = 0.0;
        for (double by : y_.of_loops) all += std::fabs(by);
        return all;
    }

    // What the level judged last would save by less of the loops' motion b, a share of it.
    double loop_saving() const {
        double all = 0.0;
        for (std::size_t i = 0, at = 0; i < kept_.size(); i++)
            for (std::size_t r = 0; r < kept_[i].size(); r++, at++)
                all -= y_.of_loops[at] * b_[at];
        return all;
    }

    // Whether active limits, with multipliers that say so, leave no motion to loops and exact rows:
    // whether a sum of rows that is nothing, but for rounding, asks for more than nothing: Infeasible,
    // Clashing where that is by less than solvers let rows give way, or Unproven. What multipliers
    // prove needs no finer ones.
    //   first: how many rows are exact, all of level 0.
    //   width: by how much rows that depend on others have given way.
    Status excludes(int first, const Constraints& c, double width = CONSISTENT) {
        clear(y_.g, m_.blocks);
        y_.push_limits(c.nearest, c.limits.G, c.limits.h.size());
        Status proof = Status::Unproven;
        for (int pass = 0; pass < MOST_PASSES && proof != Status::Infeasible; pass++) {
            y_.balance(first);
            proof = proved(c, width);
        }
        return proof;
    }

  private:
    // What the multipliers as they are prove, of excludes.
    Status proved(const Constraints& c, double width) const {
        const Level& level = levels_[0];
        double all = 0.0, asked = 0.0, widest2 = 0.0;
        for (int i = 0; i < m_.blocks * LANES; i++) {
            const double by = y_.box[i], most = std::max(std::fabs(c.limits.lb[i]), std::fabs(c.limits.ub[i]));
            all += std::fabs(by);
            if (by != 0.0) asked -= by * (by > 0.0 ? c.limits.ub[i] : c.limits.lb[i]);
            widest2 += std::min(most, FASTEST) * std::min(most, FASTEST);
        }
        for (std::size_t i = 0; i < y_.of_rows.size(); i++) {
            if (y_.of_rows[i] == 0.0) continue;
            if (y_.of_rows[i] < 0.0) return Status::Unproven;
            all += y_.of_rows[i];
            asked -= y_.of_rows[i] * c.limits.h[i];
        }
        std::size_t rows = 0;
        for (const auto& of_loop : kept_) rows += of_loop.size();
        for (std::size_t i = 0; i < rows; i++) {
            all += std::fabs(y_.of_loops[i]);
            asked -= y_.of_loops[i] * b_[i];
        }
        double given = 0.0;  // by rows that depend on others
        for (int s = 0; s < level.exact; s++) {
            all += std::fabs(y_.of_exact(s));
            given += width * std::fabs(y_.spare[std::size_t(s)]);
        }
        for (int s = 0; s < level.hard; s++) asked -= y_.of_exact(s) * level.wanted[std::size_t(s)];
        const double off = std::sqrt(dot(y_.g, y_.g, m_.blocks) * widest2);
        for (int k = 0; k < shares_.count(); k++) {
            const double by = y_.at_share(k);  // what keeps it between 0 and 1 balances this
            all += std::fabs(by);
            asked -= std::max(by, 0.0);
        }
        if (asked - off > CLEARLY * all) return Status::Infeasible;
        return asked - off > given + CLOSELY * all ? Status::Clashing : Status::Unproven;
    }

    // How far v may be off because limits are reached to the last digits: whether one is may matter
    // much where loops, exact rows and other limits see its motion as well.
    double unsure(const double* v, Constraints& c) {
        double most = 0.0;
        if (!c.nearest.active) return most;
        for (const Joint& joint : m_.joints) {
            const double slack = std::min(v[joint.lane] - c.limits.lb[joint.lane], c.limits.ub[joint.lane] - v[joint.lane]);
            if (slack <= VIOLATION) most = std::max(most, c.nearest.unsure(joint.lane, m_.blocks));
        }
        for (std::size_t at = 0; at < slack_.size(); at++)
            if (slack_[at] <= VIOLATION)
                most = std::max(most, c.nearest.unsure(m_.blocks * LANES + int(at), m_.blocks));
        return most;
    }

    // Put the shares between 0 and 1; by how much they were not, squared.
    double clip_shares() {
        double squares = 0.0;
        for (int k = 0; k < shares_.count(); k++) {
            const double inside = std::min(std::max(shares_.share(k), 0.0), 1.0);
            squares += (shares_.share(k) - inside) * (shares_.share(k) - inside);
            shares_.share(k) = inside;
        }
        return squares;
    }

    // The part of the shares in a projected gradient step, squared. Their cost bends by SCALE_WEIGHT,
    // not by mu alone: the step is taken in this metric, and a share counts by the motion that costs
    // as much.
    double share_distance2(double mu) const {
        double squares = 0.0;
        for (int k = 0; k < shares_.count(); k++) {
            const double s = shares_.share(k);
            const double step = levels_[0].best_share(k) + y_.at_share(k) / SCALE_WEIGHT;
            const double off = s - std::min(std::max(step, 0.0), 1.0);
            squares += off * off;
        }
        return squares * SCALE_WEIGHT / mu;
    }

    // What keeps each share at one of its bounds.
    void find_firm() {
        for (int k = 0; k < shares_.count(); k++) {
            const double s = shares_.share(k);
            const double slope = SCALE_WEIGHT * (s - levels_[0].best_share(k)) - y_.at_share(k);
            shares_.firm(k) = at_bound(s) ? std::max(s < 0.5 ? slope : -slope, 0.0) : 0.0;
        }
    }

    // Put v between its bounds; by how much it was not, squared.
    double clip(double* v, const double* lb, const double* ub) const {
        v4* x = lanes(v);
        const v4 *lo = lanes(lb), *hi = lanes(ub);
        v4 squares = v4{};
        for (int b = 0; b < m_.blocks; b++) {
            const v4 inside = smaller(larger(x[b], lo[b]), hi[b]), over = x[b] - inside;
            squares += over * over;
            x[b] = inside;
        }
        return sum(squares);
    }

    // How far the arms' twists are from moving the loops by b, or not at all, squared.
    double loop_gap(const double* b) {
        double gap2 = 0.0;
        std::size_t at = 0;
        for (int i = 1; i < m_.holding; i++) {
            const double* V_i = of_arms_ + TWIST * i;
            for (int r : kept_[std::size_t(i - 1)]) {
                const double off = V_i[r] - of_arms_[r] - (b ? b[at] : 0.0);
                gap2 += off * off;
                r_.of_loops[at++] = -off;
            }
        }
        return gap2;
    }

    // What the level moves of what was decided before it.
    double decided_gap(int l, const double* v, const double* before, const double* V_before) {
        double gap2 = 0.0;
        alignas(64) double V_moved[TWIST];
        for (int s = 0; l == 0 && s < levels_[0].exact; s++) {
            const Level& level = levels_[0];
            double off = rows_.times(level, s, v, V);
            if (level.share[std::size_t(s)] < 0) off -= level.wanted[std::size_t(s)];
            for (int k = 0; k < level.shares; k++) off -= shares_.share(k) * level.asks(s, k);
            gap2 += off * off;
            r_.of_rows[std::size_t(s)] = -off;
        }
        if (l == 0) return gap2;
        for (int b = 0; b < m_.blocks; b++) lanes(moved_)[b] = lanes(v)[b] - lanes(before)[b];
        for (int b = 0; b < 2; b++) lanes(V_moved)[b] = lanes(V)[b] - lanes(V_before)[b];
        std::size_t at = 0;
        for (int k = 0; k < l; k++)
            for (int s = 0; s < levels_[std::size_t(k)].rows; s++) {
                const double off = rows_.times(levels_[std::size_t(k)], s, moved_, V_moved);
                gap2 += off * off;
                r_.of_rows[at++] = -off;
            }
        return gap2;
    }

    // g = the level's gradient, with what active limits push; y_.box has the part of bounds on v.
    void gradient(int l, double d, const double* v, const Constraints& c) {
        const Level& level = levels_[std::size_t(l)];
        const double curvature = d + level.joint_weight;
        alignas(64) double tau[TWIST] = {};
        for (int b = 0; b < m_.blocks; b++) lanes(y_.g)[b] = lanes(v)[b] * curvature;
        if (level.joint_weight > 0.0) add(y_.g, level.wish, -1.0, m_.blocks);
        for (int s = level.exact; s < level.rows; s++) {
            const std::size_t i = std::size_t(s);
            const double missed = rows_.times(level, s, v, V) - level.wanted[i];
            rows_.pull_row(level, s, level.weight[i] * missed, tau, y_.g);
        }
        if (level.rows > level.exact) rows_.pull_object(tau, y_.g);
        y_.push_held(moved_);
        y_.push_limits(c.nearest, c.limits.G, c.limits.h.size());
    }

    // Norm of a projected gradient step, an estimate of |v - v*|. g has the bounds' part in it.
    double distance(const double* v, const double* lb, const double* ub, double mu, bool active) {
        const v4 *g = lanes(y_.g), *box = lanes(y_.box), *x = lanes(v);
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
        for (std::size_t i = 0; i < y_.of_rows.size(); i++) {
            const double z = y_.of_rows[i];  // one that pulls, where rows may only push, is all off
            const double off = z < 0.0 ? z / mu : std::max(std::min(slack_[i], z / mu), -z);
            squares += off * off;
        }
        return std::sqrt(squares);
    }

    const Model& m_;
    const Rows& rows_;
    Hierarchy& hierarchy_;
    Shares& shares_;
    const Settings& s_;
    const std::vector<Level>& levels_;
    const std::vector<std::vector<int>>& kept_;
    const double* b_ = nullptr;
    double* moved_;
    std::vector<double> slack_;
    bool exceeds_ = false;
    double* of_arms_;

  public:
    double* V;  // the object's twist at the answer judged last, or where the first sets out

  private:
    Residuals r_;
    Multipliers y_;
};

}  // namespace coopqp
