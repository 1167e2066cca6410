// Levels decided one after the other, each within the limits and what those before it leave free, and
// each answer checked.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "check.hpp"
#include "constraints.hpp"
#include "faults.hpp"
#include "hierarchy.hpp"
#include "loops.hpp"
#include "problem.hpp"
#include "refinement.hpp"
#include "rows.hpp"
#include "shares.hpp"
#include "small.hpp"

namespace coopqp {

// By how much a certificate may be short of zero before the answer is refined: as far as the kernel
// and the plain law agree [rad/s].
constexpr double SHORT_OF_DIGITS = 1e-10;
constexpr double ANOTHER = 1e-8;  // from there on an answer is another than the optimum [rad/s]
// Rows that depend on others give way by no more than they must: what is left of their width is
// spent on larger shares. First by this, then by so many times more, up to CONSISTENT [rad/s].
constexpr double LEAST_WIDTH = 1e-11, WIDER = 10.0;
constexpr double HOLD = 1e-11;  // by which rows that must hold may not, in an answer that is mended
constexpr double CLOSE = 1e-9;  // violation of limits in a second try, as daqp's first [rad/s]

class Cascade {
  public:
    // Of levels that have no more rows in a tick than here.
    Cascade(const Model& model, const Settings& settings, const Rows& rows, const Loops& loops,
            const Limits& limits, const std::vector<std::vector<int>>& kept,
            std::vector<Level>& levels, Arena& arena)
        : m_(model),
          rows_(rows),
          loops_(loops),
          levels_(levels),
          most_rows_(rows_in(levels)),
          hierarchy_(loops.free, most_rows_, arena),
          shares_(levels[0], hierarchy_, stride(), arena),
          constraints_(stride(), limits, loops.free, levels[0], shares_, arena),
          check_(model, rows, loops, hierarchy_, shares_, settings, levels, kept, arena),
          refinement_(model, rows, hierarchy_, shares_, levels[0], kept),
          accuracy_(settings.budget.accuracy),
          v_(arena.take(std::size_t(stride()))),
          before_(arena.take(std::size_t(stride()))),
          kept_v_(arena.take(std::size_t(stride()))),
          V_(arena.take(TWIST)),
          kept_V_(arena.take(TWIST)),
          t_(arena.take(std::size_t(stride()))),
          w_(arena.take(std::size_t(hierarchy_.width()))),
          x_(arena.take(std::size_t(hierarchy_.width()))),
          z_(arena.take(std::size_t(hierarchy_.width()))),
          residual_(std::size_t(most_rows_ + 1)),
          small_(most_rows_ + loops.free + 1, std::min(most_rows_, loops.free) + 1, arena),
          pulls_(levels.size()) {}

    // Set out from the motion v, in lanes, that moves the loops by b, their independent rows.
    void begin(const double* b, const double* v) {
        check_.aim(b);
        b_ = b;
        copy(v_, v, m_.blocks);
        hierarchy_.forget();
        hierarchy_.begin();
    }

    // How many answers were, since the beginning.
    int refined() const { return refined_; }

    // Decide a level within the limits and what the levels before it leave free; d: its damping.
    Status decide(int l, double d) {
        Level& level = levels_[std::size_t(l)];
        if (hierarchy_.held) {  // which is of one level alone
            hierarchy_.forget();
            decide_rows_before(l);
        }
        if (l > 0 && !hierarchy_.singular_values() && !leave_noise(l)) return Status::Singular;
        const int before = hierarchy_.rows;
        write_rows(level);
        for (int i = 0; i < hierarchy_.held; i++)
            copy(hierarchy_.row(before + level.rows + i), hierarchy_.held_row(i), hierarchy_.blocks());
        if (fault(Fault::WrongRow) && level.rows) hierarchy_.row(hierarchy_.rows)[0] += 1e-3;
        const int decided = hierarchy_.decided;
        hierarchy_.append(level.rows + hierarchy_.held, level.exact);
        copy(before_, v_, m_.blocks);
        constraints_.nearest.violation = VIOLATION;
        const Status status = decide_rows(l, before, decided, d);
        // At rest the certificate sees limits that are exceeded. Where several nearly depend on each
        // other a later level may seem to have no room, which cannot be: it may stay where it is.
        const bool no_room = l > 0 && status == Status::Unproven;
        const bool exceeds = status == Status::Optimal && check_.exceeds();
        if (status != Status::Inaccurate && !no_room && !exceeds) return status;
        copy(v_, before_, m_.blocks);
        copy(check_.V, V_, 2);
        constraints_.nearest.violation = no_room ? CLOSE : LAST_DIGITS;
        return decide_rows(l, before, decided, d);
    }

    // Take the first level, of exact rows alone, as decided by a motion v, in lanes.
    void accept(const double* v) {
        write_rows(levels_[0]);
        hierarchy_.append(levels_[0].rows, levels_[0].exact);
        copy(v_, v, m_.blocks);
        rows_.object_twist(v_, check_.V);
    }

    // Make a share of the step of the level that was decided last.
    void shorten(double share) {
        if (share == 1.0) return;
        for (int b = 0; b < m_.blocks; b++)
            lanes(v_)[b] = lanes(before_)[b] + share * (lanes(v_)[b] - lanes(before_)[b]);
        for (int b = 0; b < 2; b++)
            lanes(check_.V)[b] = lanes(V_)[b] + share * (lanes(check_.V)[b] - lanes(V_)[b]);
    }

    // What the levels have decided, in lanes.
    const double* v() const { return v_; }
    const Shares& shares() const { return shares_; }
    Check& check() { return check_; }
    const Check& check() const { return check_; }
    // Of the level that was decided last.
    const Outcome& outcome() const { return outcome_; }
    // What a later level pulls at the rows before it, Outcome::pull.
    double pull(int l) const { return pulls_[std::size_t(l)]; }

  private:
    static int rows_in(const std::vector<Level>& levels) {
        int count = 0;
        for (const Level& level : levels) count += level.rows;
        return count;
    }

    int stride() const { return m_.blocks * LANES; }

    // Decide the rows of a level, which the hierarchy has after `before` others of the levels before;
    // these have decided so many coordinates.
    Status decide_rows(int l, int before, int decided, double d) {
        Level& level = levels_[std::size_t(l)];
        miss(l, level);
        copy(V_, check_.V, 2);
        const int first = decided + (level.exact ? take_exact(level, d) : 0);
        take_soft(l, before, first, d);
        if (fault(Fault::WrongAnswer)) add(v_, loops_.Z, 1e-4, m_.blocks);
        const Status status = bring_inside(l, first, d + level.joint_weight);
        if (status == Status::Infeasible || fault(Fault::FalseProof))
            return l == 0 ? check_.excludes(first, constraints_) : Status::Unproven;
        if (status != Status::Optimal) return status;
        if (fault(Fault::WrongMultiplier)) constraints_.nearest.spoil();
        if (fault(Fault::ActiveForgotten)) constraints_.nearest.active = 0;
        Outcome outcome = check_.judge(l, first, d, v_, before_, constraints_);
        for (int pass = 0; pass < MOST_PASSES && is_short(outcome); pass++) {
            const double off = outcome.off;
            outcome = refined(l, first, d, outcome);
            if (!(outcome.off < off)) break;
        }
        const bool alone = l == 0 && level.exact && level.exact == level.rows && level.joint_weight == 0.0;
        if (alone && !clash_ && is_in_digits(outcome.status))
            outcome = with_more_digits(first, d, outcome);
        pulls_[std::size_t(l)] = outcome.pull;
        outcome_ = outcome;
        // Where rows give way so far that the answer is another, they clash.
        if (clash_ && (outcome.off > ANOTHER || outcome.status == Status::Inaccurate)) return Status::Clashing;
        if (outcome.status != Status::Inaccurate || l > 0) return outcome.status;
        const bool gives_way = level.exact > first && outcome.gap > HOLD;
        const bool optimal = outcome.off - outcome.astray <= accuracy_;
        return gives_way && optimal ? Status::Unproven : outcome.status;
    }

    // Whether nothing is wrong with an answer but its last digits. Where rows do not hold nearly so,
    // something else is.
    static bool is_short(const Outcome& found) {
        if (found.status == Status::Optimal) return found.off > SHORT_OF_DIGITS;
        return found.status == Status::Inaccurate && found.gap <= CLOSE;
    }

    // The outcome after the rest of the way to the optimum, which the gradient that the check has
    // left tells, judged anew; where rows of what the check refused do not hold they are made to, and
    // must. What is worse than before is taken back.
    Outcome refined(int l, int first, double d, const Outcome& found) {
        copy(kept_v_, v_, m_.blocks);
        copy(kept_V_, check_.V, 2);
        shares_.keep();
        const bool lacks = found.status == Status::Inaccurate && found.gap > HOLD;
        if (lacks) add(v_, check_.restoring(), 1.0, m_.blocks);
        go_on(l, first, d + levels_[std::size_t(l)].joint_weight);
        copy(check_.V, V_, 2);
        const Outcome outcome = check_.judge(l, first, d, v_, before_, constraints_);
        const bool holds = !lacks || outcome.gap <= HOLD;
        if (holds && outcome.off < found.off && is_of_use(l, outcome.status)) return outcome;
        copy(v_, kept_v_, m_.blocks);
        copy(check_.V, kept_V_, 2);
        shares_.take_back();
        return found;
    }

    // Whether an answer was refused for what more digits may mend.
    static bool is_in_digits(Status status) {
        return status == Status::Inaccurate || status == Status::Equality || status == Status::Bound;
    }

    // The outcome of the optimum of exact rows in twice the digits, which is judged as any other but
    // for the last digits of the check's own multipliers; what was found where there is none.
    Outcome with_more_digits(int first, double d, const Outcome& found) {
        copy(kept_v_, v_, m_.blocks);
        copy(kept_V_, check_.V, 2);
        shares_.keep();
        if (refinement_.find(b_, d, first, constraints_, v_)) {
            copy(check_.V, V_, 2);
            Outcome outcome = check_.judge(0, first, d, v_, before_, constraints_);
            const double gives_way = levels_[0].exact * constraints_.width();
            const bool holds = outcome.gap <= HOLD + gives_way && outcome.astray <= accuracy_;
            const bool optimal = outcome.off - outcome.astray <= accuracy_ + refinement_.digits();
            if (holds && optimal && outcome.status <= Status::Inaccurate) {
                outcome.status = Status::Optimal;
                refined_++;
                return outcome;
            }
        }
        copy(v_, kept_v_, m_.blocks);
        copy(check_.V, kept_V_, 2);
        shares_.take_back();
        return found;
    }

    // Shares beside hard tasks may matter little, Kernel::is_sure: they are of use as good as can be.
    bool is_of_use(int l, Status status) const {
        const bool beside = l == 0 && !levels_[0].aside.empty();
        return status == Status::Optimal || (beside && status == Status::Inaccurate);
    }

    // A Newton step of a level, with the limits active that are.
    void go_on(int l, int first, double curvature) {
        LeastDistance& nearest = constraints_.nearest;
        const int shares = l == 0 ? shares_.count() : 0, own = hierarchy_.decided - first;
        if (nearest.active) {
            double* slope = nearest.zeros();
            copy(slope, check_.left(), m_.blocks);
            for (int k = 0; k < shares; k++)
                slope[constraints_.share_row(k)] = check_.left_of_share(k);
            nearest.descend(slope);
            return constraints_.step(shares + loops_.free - first, shares, v_);
        }
        reduce(check_.left(), z_);
        small_.descend(z_ + first);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < own; k++) x_[first + k] = small_.x(k);
        for (int i = first + own; i < loops_.free; i++) x_[i] = -z_[i] / curvature;
        move(x_, v_);
    }

    // Rows of a level in coordinates of z, appended to those of the levels before.
    void write_rows(const Level& level) {
        for (int s = 0; s < level.rows; s++) {
            double* row = hierarchy_.row(hierarchy_.rows + s);
            if (level.twist[std::size_t(s)])
                multiply(row, loops_.W, TWIST, loops_.free, level.T + TWIST * s, Blocks<2>{});
            else
                multiply(row, loops_.Z, stride(), loops_.free,
                         level.J + std::size_t(s * stride()), m_.blocks);
        }
    }

    // Decide the rows of the levels before l without those that, at a singular pose, are
    // noise: these would freeze another motion in each tick. Whether nothing else is left.
    bool leave_noise(int l) {
        hierarchy_.hold_noise();
        for (int left = 0; left < most_rows_ && hierarchy_.decided > 0; left++) {
            hierarchy_.leave_out_smallest();
            decide_rows_before(l);
            if (hierarchy_.singular_values()) return true;
        }
        return false;
    }

    // Decide the rows of the levels before l anew.
    void decide_rows_before(int l) {
        hierarchy_.begin();
        for (int k = 0; k < l; k++) {
            write_rows(levels_[std::size_t(k)]);
            hierarchy_.append(levels_[std::size_t(k)].rows, levels_[std::size_t(k)].exact);
        }
    }

    // What v lacks of each row.
    void miss(int l, const Level& level) {
        if (l == 0) rows_.object_twist(v_, check_.V);  // later v is as it was judged
        for (int s = 0; s < level.rows; s++)
            residual_[std::size_t(s)] =
                level.wanted[std::size_t(s)] - rows_.times(level, s, v_, check_.V);
    }

    // Do what exact rows ask for; returns how many coordinates that takes.
    int take_exact(const Level& level, double d) {
        const int count = shares_.take(level, residual_.data(), x_, d);
        for (int k = 0; k < level.shares; k++) {
            clear(shares_.way(k), m_.blocks);
            move(shares_.coordinates(k), shares_.way(k));
        }
        move(x_, v_);
        for (int s = level.exact; s < level.rows; s++)
            for (int k = 0; k < count; k++)
                residual_[std::size_t(s)] -= hierarchy_.row(s)[k] * x_[k];
        return count;
    }

    // The optimum of soft rows, joint objectives and damping where no limit binds.
    void take_soft(int l, int before, int first, double d) {
        const Level& level = levels_[std::size_t(l)];
        const int own = hierarchy_.decided - first, soft = level.rows - level.exact;
        const double curvature = d + level.joint_weight;
        const double* c = nullptr;
        if (l > 0 || level.joint_weight > 0.0) {
            for (int b = 0; b < m_.blocks; b++)
                lanes(t_)[b] = -lanes(v_)[b] * curvature;
            if (level.joint_weight > 0.0) add(t_, level.wish, 1.0, m_.blocks);
            reduce(t_, z_);
            c = z_;
        }
        small_.open(soft + hierarchy_.held, own);
        for (int s = 0; s < soft; s++) {
            const double root = std::sqrt(level.weight[std::size_t(level.exact + s)]);
            const double* L = hierarchy_.row(before + level.exact + s) + first;
            for (int k = 0; k < own; k++) small_.A(s, k) = root * L[k];
            small_.b(s) = root * residual_[std::size_t(level.exact + s)];
        }
        for (int i = 0; i < hierarchy_.held; i++)
            for (int k = 0; k < own; k++)
                small_.A(soft + i, k) = hierarchy_.row(before + level.rows + i)[first + k];
        small_.solve(curvature, c ? c + first : nullptr);
        clear(x_, hierarchy_.blocks());
        for (int k = 0; k < own; k++) x_[first + k] = small_.x(k);
        if (c)
            for (int i = first + own; i < loops_.free; i++) x_[i] = c[i] / curvature;
        move(x_, v_);
    }

    // v += Z V' y
    void move(const double* y, double* v) const {
        hierarchy_.to_z(y, w_);
        add_rows(v, loops_.Z, stride(), loops_.free, w_, m_.blocks);
    }

    // y = V Z' t
    void reduce(const double* t, double* y) {
        multiply(w_, loops_.Z, stride(), loops_.free, t, m_.blocks);
        hierarchy_.to_y(w_, y);
    }

    // Change v and the shares by as little as limits ask for, in the metric of the level's cost.
    Status bring_inside(int l, int first, double curvature) {
        LeastDistance& nearest = constraints_.nearest;
        nearest.active = 0;
        clash_ = false;
        if (constraints_.hold(l, v_) || fault(Fault::LimitsForgotten)) return Status::Optimal;
        const int shares = l == 0 ? shares_.count() : 0, K = loops_.free - first;
        constraints_.begin(v_);
        for (int a = 0; a < padded(shares + K); a++)
            clear(nearest.column(a), nearest.stride() / LANES);
        for (int a = 0; a < shares; a++) constraints_.share_column(a);
        for (int a = 0; a < K; a++) free_direction(shares + a, first + a);
        constraints_.see_limits(shares + K);
        if (l > 0) constraints_.leave_decided(K);
        scale_directions(shares, K, hierarchy_.decided - first, curvature);
        Status status = nearest.solve(shares + K);
        if (l == 0 && levels_[0].exact > first)
            for (double by = LEAST_WIDTH, wide = 0.0; status == Status::Infeasible && by <= CONSISTENT;
                 wide = by, by *= WIDER) {
                clash_ = clash_ || check_.excludes(first, constraints_, wide) != Status::Unproven;
                constraints_.widen(by - wide);
                status = nearest.solve(shares + K);
            }
        if (status == Status::Optimal) constraints_.step(shares + K, shares, v_);
        return status;
    }

    // How the joints go along a coordinate that is free, in a column of the constraints.
    void free_direction(int column, int coordinate) {
        add_rows(constraints_.nearest.column(column), loops_.Z, stride(), loops_.free,
                 hierarchy_.V(coordinate), m_.blocks);
    }

    // Make of the K columns of free coordinates after `shares` those in which the level's cost bends
    // by one: of its own coordinates, then of those that it leaves free.
    void scale_directions(int shares, int K, int own, double curvature) {
        LeastDistance& nearest = constraints_.nearest;
        const int blocks = nearest.stride() / LANES;
        for (int a = 0; a < K; a++) {
            double* column = nearest.column(shares + a);
            for (int j = 0; j < a && a < own; j++)
                add(column, nearest.column(shares + j), -small_.R(j, a), blocks);
            const double scale = 1.0 / (a < own ? small_.R(a, a) : std::sqrt(curvature));
            for (int b = 0; b < blocks; b++) lanes(column)[b] *= scale;
        }
    }

    const Model& m_;
    const Rows& rows_;
    const Loops& loops_;
    std::vector<Level>& levels_;
    int most_rows_;
    Hierarchy hierarchy_;
    Shares shares_;
    Constraints constraints_;
    Check check_;
    Refinement refinement_;
    const double* b_ = nullptr;
    double accuracy_;
    double *v_, *before_, *kept_v_, *V_, *kept_V_, *t_, *w_, *x_, *z_;
    int refined_ = 0;
    bool clash_ = false;  // whether rows, if they gave way by less, would leave no motion
    std::vector<double> residual_;
    SmallLeastSquares small_;
    Outcome outcome_{};
    std::vector<double> pulls_;
};

}  // namespace coopqp
