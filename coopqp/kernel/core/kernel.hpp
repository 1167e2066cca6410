// One verified tick: kinematics, loops, levels, the look ahead.
#pragma once
#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "ahead.hpp"
#include "cascade.hpp"
#include "damping.hpp"
#include "faults.hpp"
#include "loops.hpp"
#include "nearest.hpp"
#include "observer.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "limit_recovery.hpp"
#include "separation.hpp"

namespace coopqp {

// Bodies are looked at first as if joints became faster than in the last tick by no more than this,
// plus a speed that one may set out with [rad/s, m/s].
constexpr double FASTER = 1.5, STARTS = 0.2;
constexpr int MOST_LOOKS = 8;
// Share of the accuracy to which damping must tell the motion of hard tasks: later levels multiply it.
constexpr double SURE = 0.03;

class Kernel {
  public:
    Kernel(std::unique_ptr<Arena> arena, std::unique_ptr<Model> model,
           std::vector<std::vector<int>> kept, Settings settings, std::vector<Level> given,
           std::vector<Separation> separations = {})
        : arena_(std::move(arena)),
          m_(std::move(model)),
          s_(std::move(settings)),
          kept_(std::move(kept)),
          levels(std::move(given)),
          kinematics(*m_),
          ahead_(*m_, s_, *arena_),
          rows_(*m_),
          loops_(make_loops(*m_, kept_, *arena_)),
          damping_(rows_, s_, levels, *arena_),
          separations_(std::move(separations)),
          limits(stride(), s_.inequalities, most_rows(), *arena_),
          tasks_(*m_, s_, rows_, *loops_, limits, kept_, levels, *arena_),
          nearest_(*m_, s_, rows_, *loops_, limits, kept_, levels[0], *arena_),
          limit_recovery_(*m_, s_, rows_, *loops_, limits, kept_, *arena_),
          b_(std::size_t(6 * std::max(m_->loops(), 1))),
          missed_(std::size_t(levels[0].hard)), lacks_(missed_.size()), got_(std::size_t(levels[0].exact)),
          missing_(std::size_t(levels[0].shares)), speed_(m_->joints.size()),
          set_out_(arena_->take(std::size_t(stride()))),
          v_(arena_->take(std::size_t(stride()))),
          last_(arena_->take(std::size_t(stride()))),
          near_(arena_->take(std::size_t(stride()))), base_(arena_->take(std::size_t(stride()))),
          V_(arena_->take(TWIST)),
          t_(arena_->take(std::size_t(stride()))) {
        for (const Level& level : levels)
            for (char twist : level.twist) sees_twist_ |= twist != 0;
    }

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
        for (std::size_t i = 0; i < kinematics.loop_error.size(); i++) {
            bound.loop_error[i] = kinematics.loop_error[i];
            bound.drift[i] = kinematics.loop_error[i] - bound.loop_offset[i];
        }
        std::copy(q, q + m_->n(), bound.q_seen);
        limits.h.resize(std::size_t(s_.inequalities));
        return Status::Optimal;
    }

    // Follow the loop-closure offset by measured joints; false where that is Python's.
    bool learn(LoopObserver& observer, const double* reading, double* loop_offset,
               double* observer_state) {
        if (!observer.update(kinematics, bound.q, bound.v_last, reading, loop_offset, observer_state))
            return false;
        for (std::size_t i = 0; i < kinematics.loop_error.size(); i++)
            bound.drift[i] = kinematics.loop_error[i] - loop_offset[i];
        return true;
    }

    // Decide v from the kinematics, tasks and limits as they stand. Joints that are outside their
    // limits come back first: the limits are tightened by their way.
    //   all_corrected: whether the tick before has done all of the Baumgarte stabilisation.
    Status solve(bool all_corrected) {
        for (int j = 0; j < m_->n(); j++)
            last_[m_->joints[std::size_t(j)].lane] = bound.v_last[j];
        damping_.begin(last_, bound.chatter[0]);
        aim_loops(ahead_.kappa(bound.drift));
        if (!fault(Fault::StaleFactor) && !loops_->factor()) return Status::Singular;
        if (fault(Fault::WrongDirection)) loops_->Z[0] += 1e-3;
        if (sees_twist_) loops_->see_object(rows_);
        loops_->particular(b_.data(), set_out_);
        if (fault(Fault::WrongSide)) set_out_[0] += 1e-4;
        if (!look_around()) return Status::Unproven;
        comes_back_ = s_.outside(bound.q);
        if (comes_back_) {
            const Status status = all_corrected ? find_limit_recovery() : Status::Outside;
            if (status != Status::Optimal) return status;
        }
        Status status = where_bodies_stay_apart([this] { return decide_levels(); },
                                                [this] { return tasks_.v(); });
        if (status != Status::Optimal) return status;
        status = command(tasks_.v());
        if (status == Status::Opens) return status;
        for (std::size_t l = 1; l < levels.size(); l++) {
            double& pull = bound.later_pulls[l - 1];
            pull = StepDamping::held_pull(tasks_.pull(int(l)), pull);
        }
        if (near_scaled_)
            bound.scaled_pull[0] = StepDamping::held_pull(nearest_.pull(), bound.scaled_pull[0]);
        if (comes_back_) bound.recovery[0] = limit_recovery_.pull();
        std::copy(missed_.begin(), missed_.end(), bound.missed);
        std::copy(missing_.begin(), missing_.end(), bound.missing);
        return status;
    }

    // Close the loops where the arms are at q: each carries the object as the first one does there.
    void take_hold(const double* q) {
        kinematics.place(q);
        double far = 0.0;
        for (std::size_t i = 1; i < m_->arms.size(); i++) {
            Arm& arm = m_->arms[i];
            const Frame &tip = kinematics.joint(std::size_t(arm.tip)), &object = kinematics.carried[0];
            const v4 *axes[] = {&tip.x, &tip.y, &tip.z}, *of[] = {&object.x, &object.y, &object.z};
            const v4 way = object.p - tip.p;
            for (int r = 0; r < 3; r++) {
                arm.at.p[r] = sum(*axes[r] * way);
                for (int c = 0; c < 3; c++) arm.at.R[3 * r + c] = sum(*axes[r] * *of[c]);
            }
            far = std::max(far, std::sqrt(dot3(arm.at.p, arm.at.p)));
        }
        s_.reach = reach_ + far;  // at most
    }

    // What the next three tell of the tick that was decided last; to be told again at its rows.
    struct Told {
        std::vector<double> missed, missing;
        double leaves, off_direction;
        bool comes_back;
    };
    Told told() const { return {missed_, missing_, leaves_, off_direction_, comes_back_}; }
    void tell(const Told& told) {
        missed_ = told.missed;
        missing_ = told.missing;
        leaves_ = told.leaves;
        off_direction_ = told.off_direction;
        comes_back_ = told.comes_back;
        levels[0].want();
    }

    // Whether joints were outside their limits when it was decided last.
    bool comes_back() const { return comes_back_; }

    // Whether hard or scaled tasks were not met in full when it was decided last.
    bool relaxed() const {
        const auto stuck = [](double missing) { return missing > 1.0 - MET; };
        return leaves_ > 0.0 || lacks() || std::any_of(missing_.begin(), missing_.end(), stuck);
    }
    // How many answers of levels needed twice the digits, since the beginning.
    int refined() const { return tasks_.refined() + nearest_.refined(); }
    double leaves() const { return leaves_; }  // how far scaled tasks left their directions

    // The least share of its rate at which a hard or scaled task ran; 1 without such tasks.
    double scale() const {
        const Level& level = levels[0];
        double least = leaves_ > 0.0 ? 1.0 - off_direction_ : 1.0;
        for (double missing : missing_)
            if (leaves_ == 0.0) least = std::min(least, 1.0 - missing);
        for (std::size_t i = 0; i < level.task.size(); i++) {
            const int end = i + 1 < level.task.size() ? level.task[i + 1] : level.hard;
            double lacks2 = 0.0, wanted2 = MET * MET;
            for (int s = level.task[i]; s < end; s++) {
                lacks2 += missed_[std::size_t(s)] * missed_[std::size_t(s)];
                wanted2 += level.wanted[std::size_t(s)] * level.wanted[std::size_t(s)];
            }
            least = std::min(least, 1.0 - std::sqrt(lacks2 / std::max(lacks2, wanted2)));
        }
        return least;
    }

    // Where tasks leave no answer to joints that are outside: the way back alone. Opens where that
    // is to stand still.
    Status come_back() {
        const Status status = command(limit_recovery_.v());
        if (status == Status::Opens) {
            clear(v_, m_->blocks);
            write();
        }
        bound.recovery[0] = limit_recovery_.pull();
        return status;
    }

    // For tests: e, J over the joints and rate of each row.
    std::vector<double> rows_of(int l) const { return rows_.listed(levels[std::size_t(l)], t_); }

    // For tests: how many pairs of bodies have a row.
    std::size_t near() const {
        std::size_t pairs = 0;
        for (const Separation& each : separations_) pairs += each.near();
        return pairs;
    }

    int stride() const { return m_->blocks * LANES; }
    const Model& model() const { return *m_; }
    const Settings& settings() const { return s_; }
    const Rows& rows() const { return rows_; }
    const std::vector<std::vector<int>>& kept() const { return kept_; }
    Check& check() { return tasks_.check(); }

  private:
    std::unique_ptr<Arena> arena_;
    std::unique_ptr<Model> m_;
    Settings s_;
    std::vector<std::vector<int>> kept_;

  public:
    std::vector<Level> levels;
    Kinematics kinematics;
    Bound bound;
    // At bodies that an answer brings near, and first at corners; else whoever asks does.
    bool looks_again = true;

  private:
    // b = -kappa e
    void aim_loops(double kappa) {
        std::size_t at = 0;
        for (std::size_t i = 0; i < kept_.size(); i++)
            for (int r : kept_[i]) b_[at++] = -kappa * bound.drift[6 * i + std::size_t(r)];
    }

    Status decide_levels() {
        Status status = decide_first();
        for (std::size_t l = 1; status == Status::Optimal && l < levels.size(); l++) {
            levels[l].want();
            const double damping = s_.damping + damping_.of(int(l), levels[l], bound);
            status = tasks_.decide(int(l), damping);
            if (status == Status::Optimal) tasks_.shorten(damping_.step_of(bound.later_pulls[l - 1]));
        }
        return status;
    }

    int most_rows() const {
        int rows = s_.inequalities;
        for (const Separation& each : separations_) rows += each.most_rows();
        return rows;
    }

    // Rows of bodies that are near, up to some speed of the joints. False where one is not known.
    bool look_around() {
        if (separations_.empty()) return true;
        for (std::size_t j = 0; j < speed_.size(); j++) {
            const int lane = m_->joints[j].lane;
            const double most = std::max(std::fabs(limits.lb[lane]), std::fabs(limits.ub[lane]));
            speed_[j] = std::min(FASTER * std::fabs(bound.v_last[j]) + STARTS, most);
        }
        for (Separation& each : separations_)
            if (each.begin(kinematics, speed_.data(), limits, looks_again) != Separation::Told::Kept)
                return false;
        return true;
    }

    // Decide until no pair of bodies that was left out could matter to the answer v.
    template <class Decide, class Answer>
    Status where_bodies_stay_apart(Decide decide, Answer v) {
        for (int look = 0; look < MOST_LOOKS; look++) {
            const Status status = decide();
            if (status != Status::Optimal || !looks_again) return status;
            const Separation::Told told = look_again(v());
            if (told == Separation::Told::Kept) return status;
            if (told == Separation::Told::Unknown) return Status::Unproven;
        }
        return Status::Unproven;
    }

    Separation::Told look_again(const double* v) {
        using Told = Separation::Told;
        bool faster = false;
        for (std::size_t j = 0; j < speed_.size() && !separations_.empty(); j++) {
            const double of_joint = std::fabs(v[m_->joints[j].lane]);
            faster |= of_joint > speed_[j];
            speed_[j] = std::max(speed_[j], of_joint);
        }
        Told told = Told::Kept;
        for (std::size_t i = 0; faster && i < separations_.size(); i++) {
            const Told one = separations_[i].look(kinematics, speed_.data(), v, limits);
            if (one == Told::Unknown) return one;
            if (one == Told::More) told = one;
        }
        return told;
    }

    // Hard and scaled tasks as they are, or as nearly as can be; else the first soft ones.
    Status decide_first() {
        Level& level = levels[0];
        level.want();
        d_ = s_.damping + damping_.of(0, level, bound);
        leaves_ = 0.0;
        short_ = false;
        shares_ = &tasks_.shares();
        near_scaled_ = false;
        tasks_.begin(b_.data(), set_out_);
        const Status status = tasks_.decide(0, d_);
        const bool proved = !s_.relaxes && status != Status::Unproven && status != Status::Clashing;
        const bool found = s_.relaxes && status == Status::Optimal;
        softens_ = found ? overreaches(tasks_.v(), 0, level.hard) : 0.0;
        leaves_ = found ? overreaches(tasks_.v(), level.hard, level.exact) : 0.0;
        const bool firm = softens_ == 0.0 && holds_firmly(status, false);
        if (!level.exact || proved || (firm && leaves_ == 0.0 && least_share() >= WHOLE)) {
            if (status == Status::Optimal) note_missed(tasks_.v());
            return status;
        }
        if (!may_come_near(status)) return status;
        const Status near = come_near(status, firm);
        if (near != Status::Optimal) return s_.relaxes ? near : status;
        note_missed(tasks_.v());
        // Where rows clash by less than they may give way, the nearest is as good as all.
        const bool clash = status == Status::Clashing || status == Status::Infeasible;
        const bool is_relaxed = relaxed() || short_;
        if (status == Status::Optimal || (s_.relaxes && is_relaxed) || (clash && !relaxed()))
            return near;
        const bool proof = lacks() || (clash && relaxed());  // the nearest is the proof
        return proof ? Status::Infeasible : Status::Unproven;
    }

    static bool may_come_near(Status whole) {
        return whole == Status::Clashing || whole == Status::Infeasible ||
               whole == Status::Optimal || whole == Status::Unproven || whole == Status::Inaccurate;
    }

    // Whether hard tasks lack something.
    bool lacks() const {
        return std::any_of(missed_.begin(), missed_.end(), [](double x) { return x != 0.0; });
    }

    // How much they lack.
    double lack() const {
        double missed2 = 0.0;
        for (double missed : missed_) missed2 += missed * missed;
        return std::sqrt(missed2);
    }

    // 1 where the exact motion v is at a limit, 0 where it is NEAR none.
    double at_limits(const double* v) const {
        double margin = NEAR;
        for (const Joint& joint : m_->joints) {
            const double at = v[joint.lane];
            margin = std::min(margin, std::min(limits.ub[joint.lane] - at, at - limits.lb[joint.lane]));
        }
        for (std::size_t i = 0; i < limits.h.size(); i++) {
            const double* G = limits.G + i * std::size_t(stride());
            const double size = std::max(std::sqrt(dot(G, G, m_->blocks)), IDLE);
            margin = std::min(margin, (limits.h[i] - dot(G, v, m_->blocks)) / size);
        }
        return std::min(1.0 - margin / NEAR, 1.0);
    }

    // Whether the answer of the exact program is what the levels of least squares answer.
    //   met: whether hard ones are known to be met.
    bool holds_firmly(Status whole, bool met) const {
        return whole == Status::Optimal && tasks_.check().holds_firmly(d_, met);
    }

    double least_share() {
        double least = 1.0;
        for (int k = 0; k < levels[0].shares; k++) least = std::min(least, shares_->share(k));
        return least;
    }

    // How far exact rows from one on are softened since a tick of the motion v, in lanes, bends them
    // by more than it moves them.
    double overreaches(const double* v, int from, int to) {
        if (from == to) return 0.0;
        double bounds2 = 0.0, moved2 = 0.0;
        rows_.object_twist(v, V_);
        for (int s = from; s < to; s++) {
            const double along = rows_.times(levels[0], s, v, V_);
            const double bound = levels[0].curvature_bound[std::size_t(s)];
            bounds2 += bound * bound;
            moved2 += along * along;
        }
        return damping_.overreaches(std::sqrt(bounds2) * dot(v, v, m_->blocks), std::sqrt(moved2));
    }

    // The levels of hard and of scaled tasks where not all they ask can be done.
    //   whole: of the level with all they ask.
    //   holds: whether its answer stands, of which a share is small.
    Status come_near(Status whole, bool holds) {
        off_ = off_in_shares_ = saving_ = least_leaves_ = aside_ = 0.0;
        if (!holds) {
            const Status status = move_hard(whole, holds);
            if (status != Status::Optimal) return status;
        }
        const bool scales = levels[0].shares > 0;
        if (holds) {
            copy(near_, tasks_.v(), m_->blocks);
            nearest_.accept_hard(b_.data(), near_);
        } else if (scales) {
            copy(base_, near_, m_->blocks);
            const Status status = scale_beside(near_);
            if (status != Status::Optimal) return status;
            mix(base_, near_, base_, least_leaves_);
            nearest_.accept_hard(b_.data(), base_);
        }
        if (scales && leaves_ < 1.0) {
            least_leaves_ = std::max(least_leaves_, overreaches(near_, levels[0].hard, levels[0].exact));
            leaves_ = std::max(leaves_, least_leaves_);
        }
        if (scales && (leaves_ > 0.0 || off_ > 0.0 || least_share() < WHOLE)) {
            const Status status = nearest_.of_scaled(damping_, bound.scaled_pull[0]);
            if (holds && status != Status::Optimal) return whole;  // the shares hold
            near_scaled_ = true;
            if (status != Status::Optimal) return status;
            if (leaves_ < 1.0) leaves_ = leaves(nearest_.v(), 0.0);
            if (!is_sure(nearest_.v())) return Status::Inaccurate;
            if (holds && leaves_ == 0.0) return status;
            mix(near_, near_, nearest_.v(), leaves_);
        } else if (off_ > 0.0) {
            return Status::Inaccurate;
        }
        tasks_.begin(b_.data(), set_out_);
        tasks_.accept(near_);
        return Status::Optimal;
    }

    // The motion near_ of hard tasks, the nearest where they cannot hold; what it lacks.
    //   whole: of the level with all they ask.
    //   holds: whether its answer stands after all.
    Status move_hard(Status whole, bool& holds) {
        Status status = nearest_.of_hard(b_.data(), set_out_), held = whole;
        const bool unsure = status == Status::Inaccurate;
        if (status != Status::Optimal && !unsure) return status;
        const double part = note_missed(nearest_.v());
        const double* exact = tasks_.v();
        if (levels[0].shares) {
            const bool alone = levels[0].hard && lack() < SLOW;
            held = alone ? nearest_.hold(b_.data(), set_out_) : Status::Optimal;
            exact = alone ? nearest_.held() : nearest_.v();
        }
        if (!may_come_near(held) || held == Status::Inaccurate) return held;
        double counts = 1.0;
        if (held == Status::Optimal) {
            counts = std::max(at_limits(exact), 2.0 * lack() / SLOW - 1.0);
            counts = part * std::min(std::max(counts, 0.0), 1.0);
        }
        for (std::size_t s = 0; s < missed_.size(); s++) lacks_[s] = counts * std::fabs(missed_[s]);
        const bool damps = counts == 1.0 && nearest_.unsure(lacks_.data()) <= SURE * s_.budget.accuracy;
        if (unsure && !damps) return Status::Inaccurate;
        if (counts > 0.0) {
            status = nearest_.damp(damping_, lacks_.data(), b_.data(), set_out_);
            if (status != Status::Optimal) return status;
        }
        mix(near_, counts == 1.0 ? nearest_.v() : exact, nearest_.v(), counts);
        softens_ = overreaches(near_, 0, levels[0].hard);
        short_ = counts > 0.0 || softens_ > 0.0;
        holds = !short_ && holds_firmly(whole, true);
        if (softens_ > 0.0) {
            for (std::size_t s = 0; s < lacks_.size(); s++)
                lacks_[s] += softens_ * std::fabs(levels[0].wanted[s]);
            status = nearest_.damp(damping_, lacks_.data(), b_.data(), set_out_);
            if (status != Status::Optimal) return status;
            mix(near_, near_, nearest_.v(), softens_);
        }
        note_missed(near_);
        return Status::Optimal;
    }

    // What lies between two motions inside limits, a share of the way.
    void mix(double* v, const double* from, const double* to, double share) {
        for (int b = 0; b < m_->blocks; b++) {
            const v4 between = lanes(from)[b] + share * (lanes(to)[b] - lanes(from)[b]);
            lanes(v)[b] = smaller(larger(between, lanes(limits.lb)[b]), lanes(limits.ub)[b]);
        }
    }

    // The largest shares that a motion v of hard tasks leaves, which v becomes, and how far these
    // may be left.
    Status scale_beside(double* v) {
        const Level& level = levels[0];
        rows_.object_twist(v, V_);
        for (int s = 0; s < level.exact; s++) got_[std::size_t(s)] = rows_.times(level, s, v, V_);
        leaves_ = least_leaves_ = std::min(lack() / SLOW, 1.0);
        if (leaves_ == 1.0) return Status::Optimal;
        const Status status = nearest_.of_shares(got_.data(), d_, b_.data(), set_out_);
        shares_ = &nearest_.beside().shares();
        if (status == Status::Infeasible || status == Status::Unproven || status == Status::Clashing) {
            leaves_ = 1.0;
            return Status::Optimal;
        }
        const Outcome& found = nearest_.beside().outcome();
        if (status == Status::Inaccurate && found.astray <= s_.budget.accuracy)
            off_ = found.off;  // which may matter little, is_sure
        else if (status != Status::Optimal)
            return status;
        off_in_shares_ = off_ * std::sqrt(std::min(d_ / SCALE_WEIGHT, 1.0));
        saving_ = off_ * off_ * d_ / 4.0;
        copy(v, nearest_.beside().v(), m_->blocks);
        aside_ = nearest_.aside();
        leaves_ = std::max(leaves_, aside_);
        return Status::Optimal;
    }

    // Whether the command is sure, although the motion with the largest shares is off by off_: the
    // more scaled tasks leave it for the nearest motion, in lanes, the less it is in the command.
    bool is_sure(const double* near) {
        if (off_ == 0.0) return true;
        const double least = leaves(near, -1.0), most = leaves(near, 1.0);
        double apart2 = 0.0;
        for (int i = 0; i < stride(); i++) apart2 += (near[i] - near_[i]) * (near[i] - near_[i]);
        return (1.0 - least) * off_ + (most - least) * std::sqrt(apart2) <= s_.budget.accuracy;
    }

    // How far scaled tasks leave their directions for the nearest motion, in lanes.
    //   by: 1, with t as large as it may be, and the shares as small; -1, the other way round; or 0.
    double leaves(const double* near, double by) {
        const double direction = leaves_direction(near, by);
        return std::max(std::max(least_leaves_, moved(aside_, levels[0].shares, by)), direction);
    }

    // Share k, larger by as much as it may be.
    double moved(double share, int k, double by) const {
        if (by == 0.0) return share;
        const double firm = shares_->firm(k);
        const double most = firm > 0.0 ? std::min(off_in_shares_, saving_ / firm) : off_in_shares_;
        return std::min(std::max(share + by * most, 0.0), 1.0);
    }

    // As coopqp.qp_law.nearest.blocked.
    double leaves_direction(const double* near, double by) {
        const Level& level = levels[0];
        double most = 0.0;
        rows_.object_twist(near, V_);
        for (int k = 0; k < level.shares; k++) {
            double wanted2 = 0.0, along = 0.0;
            for (int s = level.hard; s < level.exact; s++) {
                if (level.share[std::size_t(s)] != k) continue;
                const double wanted = level.wanted[std::size_t(s)];
                wanted2 += wanted * wanted;
                along += wanted * rows_.times(level, s, near, V_);
            }
            along = std::max(along, LEAST_SPEED * std::sqrt(wanted2));
            const double share = moved(shares_->share(k), k, -by);
            const double left = along > 0.0 ? std::max(1.0 - share * wanted2 / (LITTLE * along), 0.0) : 0.0;
            most = std::max(most, left * std::max(1.0 - share / WHOLE, 0.0));
        }
        return most;
    }

    // What rows of hard tasks lack of what they want, and shares to 1. Returns how much of the first
    // counts, from none to all of it.
    double note_missed(const double* v) {
        const Level& level = levels[0];
        if (level.hard || leaves_ > 0.0) rows_.object_twist(v, V_);
        if (leaves_ > 0.0) note_direction(v);
        double most = 0.0;
        for (int s = 0; s < level.hard; s++) {
            double& missed = missed_[std::size_t(s)];
            missed = rows_.times(level, s, v, V_) - level.wanted[std::size_t(s)];
            most = std::max(most, std::fabs(missed));
        }
        const double part = std::min(std::max(most / MET - 1.0, 0.0), 1.0);
        for (double& missed : missed_) missed *= part;
        for (int k = 0; k < level.shares; k++)
            missing_[std::size_t(k)] =
                leaves_ == 1.0 ? 1.0 : 1.0 - (1.0 - leaves_) * shares_->share(k);
        return part;
    }

    // How much scaled tasks that leave their directions lack of what they want, as a share; after the
    // object's twist.
    void note_direction(const double* v) {
        const Level& level = levels[0];
        off_direction_ = 0.0;
        for (int k = 0; k < level.shares; k++) {
            double lack2 = 0.0, wanted2 = MET * MET;
            for (int s = level.hard; s < level.exact; s++) {
                if (level.share[std::size_t(s)] != k) continue;
                const double wanted = level.wanted[std::size_t(s)];
                const double lack = rows_.times(level, s, v, V_) - wanted;
                lack2 += lack * lack;
                wanted2 += wanted * wanted;
            }
            off_direction_ = std::max(off_direction_, std::sqrt(lack2 / std::max(lack2, wanted2)));
        }
    }

    Status find_limit_recovery() {
        const double damping = damping_.of(s_.reach * bound.recovery[0]);
        const Status status = where_bodies_stay_apart(
            [&] { return limit_recovery_.find(bound.q, damping, b_.data(), set_out_); },
            [this] { return limit_recovery_.v(); });
        if (status == Status::Optimal) limit_recovery_.keep(bound.q, limits);
        return status;
    }

    // v in lanes, or as much of it as leaves the loops within their budget, is what joints do.
    Status command(const double* v) {
        copy(v_, v, m_->blocks);
        const double share = ahead_.shorten(bound.q, bound.loop_offset, bound.drift, v_);
        if (share == 0.0) return Status::Opens;
        write();
        return share < 1.0 ? Status::Shortened : Status::Optimal;
    }

    void write() {
        for (int j = 0; j < m_->n(); j++) bound.v[j] = v_[m_->joints[std::size_t(j)].lane];
        damping_.note_chatter(*m_, v_, bound.chatter);
    }

    const double reach_ = s_.reach;  // as it was given
    Ahead ahead_;
    Rows rows_;
    std::unique_ptr<Loops> loops_;
    StepDamping damping_;

    std::vector<Separation> separations_;

  public:
    Limits limits;

  private:
    Cascade tasks_;
    Nearest nearest_;
    LimitRecovery limit_recovery_;
    std::vector<double> b_;
    std::vector<double> missed_, lacks_, got_;  // of hard rows, of which sizes, and of all exact ones
    bool short_ = false;                   // whether the nearest motion of hard tasks lacks anything
    const Shares* shares_ = nullptr;       // that were decided last
    std::vector<double> missing_;          // of shares
    std::vector<double> speed_;            // of joints, up to which bodies were looked at
    double off_direction_ = 0.0;           // what scaled tasks lack then, a share
    double d_ = 0.0;                       // damping of the first level
    double leaves_ = 0.0;                  // how far scaled tasks leave their directions
    double least_leaves_ = 0.0, aside_ = 0.0;  // what of it hard tasks ask for: by what they lack, t
    // By how much the motion with the largest shares beside them may be off, and t and these shares, by
    // strong convexity: N^2 + sum_k firm_k |ds_k| <= sqrt(d) off N, N^2 = W |ds|^2 + d |dv|^2, firm_k
    // where a bound holds share k. So no firm_k |ds_k| is more than saving, d off^2 / 4.
    double off_ = 0.0, off_in_shares_ = 0.0, saving_ = 0.0;
    double softens_ = 0.0;                 // how far hard tasks are damped like soft ones
    bool near_scaled_ = false;             // whether their nearest motion was looked for
    double *set_out_, *v_, *last_, *near_, *base_, *V_, *t_;
    bool comes_back_ = false;
    bool sees_twist_ = false;  // whether there are rows that see the object's twist
};

}  // namespace coopqp
