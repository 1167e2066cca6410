// The kernel as a Python class. Arrays are bound once; the GIL is released for all that takes long.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <optional>

#include "bound_state.hpp"
#include "core/resolved_rate.hpp"
#include "reading.hpp"

// Of its own name in each variant, so that two of them may be imported side by side.
namespace KERNEL_MODULE {

using coopqp::BUSY, coopqp::RELAXED, coopqp::STANDS, coopqp::COMES_BACK, coopqp::DOUBTFUL;

// Rows that Python fills, and where they go.
struct Filled {
    const double *e, *J, *rate;
    int level, at, rows;
    double weight, gain;  // of joint objectives
    bool joints;
};

struct FilledLimits {
    const double *lb, *ub, *G, *h;
    std::size_t rows;
};

class Engine {
  public:
    explicit Engine(const nb::dict& d) {
        auto arena = std::make_unique<coopqp::Arena>();
        auto model = model_of(nb::cast<nb::dict>(d["model"]), *arena);
        auto levels = levels_of(d, *model, *arena);
        const auto settings = settings_of(nb::cast<nb::dict>(d["settings"]));
        program_.primitives = primitives_of(d);
        for (const auto& p : program_.primitives) {
            if (p.kind != coopqp::Kind::Posture) continue;
            const std::size_t stride = std::size_t(model->blocks) * coopqp::LANES;
            double* J = levels[std::size_t(p.level)].J + std::size_t(p.at) * stride;
            for (std::size_t i = 0; i < p.rows.size(); i++)
                J[i * stride + std::size_t(model->joints[std::size_t(p.rows[i])].lane)] = 1.0;
        }
        program_.open(*model, *arena);
        bounds_ = bounds_of(nb::cast<nb::list>(d["joint_limits"]), model->joints.size(), settings.dt);
        for (nb::handle limit : nb::cast<nb::list>(d["twist_limits"]))
            twist_limits_.limits.push_back(twist_limit_of(nb::cast<nb::dict>(limit)));
        std::vector<coopqp::Separation> separations;
        for (nb::handle limit : nb::cast<nb::list>(d["distances"]))
            separations.push_back(separation_of(nb::cast<nb::dict>(limit), *model, settings.dt));
        kernel_ = std::make_unique<coopqp::Kernel>(std::move(arena), std::move(model),
                                                   kept_of(numbers(d, "kept")), settings,
                                                   std::move(levels), std::move(separations));
    }

    // Arrays of a state, of what the law remembers and of its command, by name; false where busy.
    bool bind_state(const nb::dict& d) {
        const Use use(*this);
        if (!use.alone) return false;
        auto& b = kernel_->bound;
        const auto of = [&](const char* name) { return nb::cast<Written>(d[name]).data(); };
        b.q = q_now_ = of("q");
        b.v_last = v_now_ = of("v");
        commanded_ = of("commanded");
        b.loop_offset = of("loop_offset");
        b.p_WO = of("p_WO");
        b.R_WO = of("R_WO");
        b.loop_error = of("loop_error");
        b.drift = of("drift");
        J_ext_ = of("J_ext");
        b.q_seen = of("q_seen");
        b.later_pulls = of("later pulls");
        b.missed = of("missed");
        b.missing = of("missing");
        b.scaled_pull = of("scaled pull");
        b.recovery = of("recovery");
        b.chatter = of("chatter");
        stopped_ = of("stopped");
        loop_offset_ = of("loop_offset");
        observer_state_ = of("observer_state");
        b.v = of("command");
        const auto memory = nb::cast<Written>(d["memory"]);
        memory_ = memory.data();
        kept_.resize(memory.size());
        state_ = d;
        return true;
    }

    // Whose arrays these are, and what tells of them, as BoundState has it; nobody's after `let_go`.
    void bind_owner(nb::object state, nb::object command, nb::list same, nb::list usual,
                    nb::list said) {
        owner_.emplace(std::move(state), std::move(command), std::move(same), std::move(usual),
                       std::move(said));
    }
    void let_go() { owner_.reset(); }
    int visit(visitproc visit, void* arg) const { return owner_ ? owner_->visit(visit, arg) : 0; }
    const nb::object& command() const { return owner_->command(); }
    bool is_bound(nb::handle state) const { return owner_ && owner_->is(state); }

    void bind_measured(const Numbers& q) {
        bounds_.q_measured = q.data();
        measured_ = nb::cast(q);
    }

    // Joints as measured in the next ticks, and who follows the loop-closure offset by them.
    void bind_reading(const Numbers& q) {
        reading_ = q.data();
        read_ = nb::cast(q);
    }
    void bind_observer(const nb::dict& d) {
        observer_ = std::make_unique<coopqp::LoopObserver>(kernel_->model(), observed_of(d));
        observing_ = d;
    }

    // Limits that Python fills: bounds beside those of the kernel, and rows after the kernel's.
    void bind_limits(const Numbers& lb, const Numbers& ub, const Numbers& G, const Numbers& h) {
        filled_limits_ = {lb.data(), ub.data(), G.data(), h.data(), h.size()};
        limits_ = nb::make_tuple(lb, ub, G, h);
    }

    void bind_rows(const Numbers& e, const Numbers& J, const Numbers& rate, int level, int at,
                   bool joints, double weight, double gain) {
        filled_.push_back(
            {e.data(), J.data(), rate.data(), level, at, int(e.size()), weight, gain, joints});
        rows_.append(nb::make_tuple(e, J, rate));
    }

    void bind_reference(std::size_t primitive, const Numbers& c, const Numbers& RT,
                        const Numbers& c_dot, const Numbers& omega) {
        program_.primitives.at(primitive).reference.followed = {c.data(), RT.data(), c_dot.data(),
                                                                omega.data()};
        references_[nb::int_(primitive)] = nb::make_tuple(c, RT, c_dot, omega);
    }

    // A whole tick of a problem of which Python fills nothing; all_corrected: as in Kernel::solve.
    int tick(double t, bool all_corrected) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        const Unlocked unlocked(*kernel_);
        const int status = evaluate(t);
        return status ? status : told(solve(t, all_corrected));
    }

    // The same with measured joints; learns: whether the loop-closure offset follows them first.
    int tick_measured(double t, bool all_corrected, bool learns) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        if (observer_) observer_->begin();
        if (!usable()) return int(coopqp::Status::Unusual);
        const Unlocked unlocked(*kernel_);
        const int status = evaluate(t, learns);
        return status ? status : told(solve(t, all_corrected));
    }

    // Where Python decides after all: what that has learnt is forgotten.
    void forget_measured() {
        if (observer_) observer_->forget();
    }

    // What Python needs to fill limits, rows of some tasks, or what some of them follow; then they
    // decide with the kernel's own, tick_with_rows.
    int place(double t) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        const int status = int(kernel_->update(t));
        if (!status) kernel_->kinematics.write_jacobian(J_ext_);
        return status;
    }

    int tick_with_rows(double t, bool all_corrected) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        const Unlocked unlocked(*kernel_);
        fill(t);
        doubtful_ = false;
        for (const Filled& rows : filled_) take_rows(rows);
        if (filled_limits_.lb) take_limits();
        return told(kernel_->solve(all_corrected));
    }

    // After a tick that was infeasible, where nothing may be given up: joints that are outside their
    // limits come back, others stand still.
    int rest() {
        const Use use(*this);
        return use.alone ? come_back() : BUSY;
    }

    // The least share of its rate at which a hard or scaled task ran in the last tick.
    double scale() const { return kernel_->levels[0].exact ? kernel_->scale() : 1.0; }

    // A whole tick, and the step q += v dt of joints that do as told, where it has an answer, after
    // which Python's objects are as an optimal one leaves them; not where the law stands still, is
    // bound to another state, something of it is not usual, or the tick before has not done all of
    // the Baumgarte stabilisation.
    int step(nb::handle state) {
        const Use use(*this);
        double t, corrected;
        if (!use.alone || !owner_ || !owner_->begins(state, t, corrected) || waits()) return BUSY;
        if (!(corrected >= coopqp::ALL_OF_IT)) return BUSY;
        coopqp::Status decided;
        {
            const Unlocked unlocked(*kernel_);
            const int status = evaluate(t);
            if (status) return status;
            decided = solve(t, true);
            if (is_answer(decided)) advance();
        }
        if (!is_answer(decided)) return told(decided);
        owner_->leave(t + kernel_->settings().dt, corrected, !takes_long(*kernel_));
        if (kernel_->levels[0].exact) owner_->leave_scale(kernel_->scale());
        return told(decided);
    }

    // A whole tick of a law in closed form; SINGULAR where it has no answer. share: of the second
    // level's wish in Z. The others are as in the constructor, and always the same.
    int resolve(double t, double damping, bool weighted, double share) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        const int status = evaluate(t);
        if (status) return status;
        if (!resolved_rate_) resolved_rate_.emplace(*kernel_, damping, weighted);
        kernel_->kinematics.write_jacobian(J_ext_);
        return int(resolved_rate_->solve(J_ext_, share) ? coopqp::Status::Optimal
                                                        : coopqp::Status::Singular);
    }

    // Ticks and steps until one that is Python's, from the state that is bound. Written: q before
    // each tick and at the end, shape (T + 1, n), v of each of T ticks, who decided it and how, the
    // least share of a hard or scaled task's rate, and what of `memory` was there before it.
    // Returns how many were done; signals of the process wait as long.
    int run(double t, const Written& q, const Written& v, const Said& said, const Written& scale,
            const Numbers& memory, const Written& remembered, bool stops, bool all_corrected) {
        const Use use(*this);
        if (!use.alone || !q_now_) return BUSY;
        const std::size_t n = kernel_->model().joints.size(), ticks = said.size();
        const std::size_t kept = memory.size();
        if (q.size() < n * (ticks + 1) || v.size() < n * ticks || scale.size() < ticks ||
            remembered.size() < kept * ticks)
            return BUSY;
        nb::gil_scoped_release released;
        std::size_t done = 0;
        for (; done < ticks; done++) {
            std::copy_n(memory.data(), kept, remembered.data() + done * kept);
            const int how = go_on(t, q.data() + done * n, v.data() + done * n, stops, all_corrected);
            if (how == BUSY) break;
            said.data()[done] = std::uint8_t(how);
            scale.data()[done] = scale_of(how);
            all_corrected = true;
        }
        std::copy(q_now_, q_now_ + n, q.data() + done * n);
        return int(done);
    }

    // Whole motions from `starts`, at rest and with nothing remembered, by the state that is bound;
    // q, shape (M, T + 1, n), v and what was said as above, and how many ticks of each were done.
    void run_starts(double t, const Numbers& starts, const Written& q, const Written& v,
                    const Said& said, const Written& memory, const Counts& done, bool stops) {
        const Use use(*this);
        const std::size_t n = kernel_->model().joints.size(), m = done.size();
        const std::size_t ticks = m ? said.size() / m : 0;
        if (!use.alone || !q_now_ || starts.size() < m * n || v.size() < m * ticks * n ||
            q.size() < m * (ticks + 1) * n)
            return;
        nb::gil_scoped_release released;
        for (std::size_t i = 0; i < m; i++) {
            std::copy_n(starts.data() + i * n, n, q_now_);
            std::fill_n(v_now_, n, 0.0);
            std::fill_n(memory.data(), memory.size(), 0.0);
            double now = t, *place = q.data() + i * (ticks + 1) * n;
            std::size_t k = 0;
            for (; k < ticks; k++) {
                const std::size_t at = i * ticks + k;
                const int how = go_on(now, place + k * n, v.data() + at * n, stops, true);
                if (how == BUSY) break;
                said.data()[at] = std::uint8_t(how);
            }
            std::copy_n(q_now_, n, place + k * n);
            done.data()[i] = std::int32_t(k);
        }
    }

    // Where joints are a tick after q that go towards x, with the loops left open by the offset; q itself
    // where there is no answer, which is told. Of one task of least velocity. about: where they will be at about;
    // null: only bodies that are near by now count.
    bool toward(const double* q, const double* x, const double* loop_offset, const double* about, double* to) {
        const auto& m = kernel_->model();
        const double dt = kernel_->settings().dt;
        for (std::size_t j = 0; j < m.joints.size(); j++) {
            q_now_[j] = q[j];
            v_now_[j] = about ? (about[j] - q[j]) / dt : 0.0;
        }
        if (loop_offset) std::copy_n(loop_offset, 6 * m.loops(), loop_offset_);
        std::fill_n(kernel_->bound.chatter, 1 + m.joints.size(), 0.0);
        kernel_->looks_again = about;
        coopqp::Status status = kernel_->update(0.0);
        if (status == coopqp::Status::Optimal) {
            fill(0.0);
            coopqp::Level& level = kernel_->levels[0];
            for (std::size_t j = 0; j < m.joints.size(); j++)
                level.wish[m.joints[j].lane] += level.joint_weight * (x[j] - q[j]) / dt;
            status = kernel_->solve(true);
        }
        const double* v = kernel_->bound.v;
        for (std::size_t j = 0; j < m.joints.size(); j++)
            to[j] = q_now_[j] + (is_answer(status) ? dt * v[j] : 0.0);
        return is_answer(status);
    }

    coopqp::Kernel& kernel() { return *kernel_; }

    // e, J and rate of a level's rows, one row after the other, for tests.
    std::vector<double> rows(int level) const { return kernel_->rows_of(level); }

    // How many pairs of bodies had a row in the last tick, for tests.
    std::size_t near() const { return kernel_->near(); }

    // Whether another thread may have the GIL meanwhile.
    bool unlocks() const { return takes_long(*kernel_); }

    std::vector<double> worst() const {
        return {kernel_->check().worst_primal, kernel_->check().worst_dual};
    }

  private:
    // The status of a tick and who decided it; BUSY where that is Python's.
    //   stops: whether the law stands still from a tick on that is infeasible.
    int decide(double t, bool stops, bool all_corrected) {
        if (evaluate(t)) return BUSY;
        if (*stopped_ != 0.0) return stand_still();
        const coopqp::Status status = solve(t, all_corrected);
        if (is_answer(status)) return told(status);
        if (status != coopqp::Status::Infeasible || kernel_->settings().relaxes) return BUSY;
        *stopped_ = stops ? 1.0 : 0.0;
        forget_exact();
        return come_back();
    }

    // A tick of a run at t, which goes on, and its step; BUSY where it is Python's.
    int go_on(double& t, double* q, double* v, bool stops, bool all_corrected) {
        const std::size_t n = kernel_->model().joints.size();
        std::copy_n(q_now_, n, q);
        const int how = decide(t, stops, all_corrected);
        if (how == BUSY) return BUSY;
        advance();
        std::copy_n(v_now_, n, v);
        t += kernel_->settings().dt;
        return how;
    }

    // As coopqp.kernel.law says it.
    double scale_of(int how) const {
        return kernel_->levels[0].exact && how & STANDS ? 0.0 : scale();
    }

    // Decide what was evaluated. Where that took twice the digits it is asked whether joints that
    // differ in their last digits have another answer, which then is doubtful.
    coopqp::Status solve(double t, bool all_corrected) {
        auto& bound = kernel_->bound;
        const int refined = kernel_->refined();
        doubtful_ = false;
        const bool may_refine = kernel_->levels[0].exact;  // no other answers take twice the digits
        if (may_refine) std::copy_n(memory_, kept_.size(), kept_.data());
        const coopqp::Status status = kernel_->solve(all_corrected);
        if (!is_answer(status) || kernel_->refined() == refined) return status;
        const double* q = bound.q;
        const std::size_t n = kernel_->model().joints.size();
        answer_.assign(bound.v, bound.v + n);
        after_.assign(memory_, memory_ + kept_.size());
        const auto told = kernel_->told();
        for (double by : {NEIGHBOUR, -NEIGHBOUR}) {
            beside_.assign(q, q + n);
            for (std::size_t j = 0; j < n; j++) beside_[j] *= 1.0 + (j % 2 ? by : -by);
            bound.q = beside_.data();
            std::copy_n(kept_.data(), kept_.size(), memory_);
            doubtful_ |= evaluate(t) != 0 || !is_answer(kernel_->solve(all_corrected));
            for (std::size_t j = 0; j < n; j++)
                doubtful_ |= !(std::fabs(bound.v[j] - answer_[j]) <= kernel_->settings().budget.accuracy);
        }
        bound.q = q;
        std::copy(after_.begin(), after_.end(), memory_);
        std::copy(answer_.begin(), answer_.end(), bound.v);
        evaluate(t);
        kernel_->tell(told);
        return status;
    }

    static bool is_answer(coopqp::Status status) {
        return status == coopqp::Status::Optimal || status == coopqp::Status::Shortened;
    }

    int told(coopqp::Status status) const {
        if (!is_answer(status)) return int(status);
        return int(status) + (kernel_->relaxed() ? RELAXED : 0) +
               (kernel_->comes_back() ? COMES_BACK : 0) + (doubtful_ ? DOUBTFUL : 0);
    }

    void forget_exact() {
        const auto& bound = kernel_->bound;
        std::fill_n(bound.missed, kernel_->levels[0].hard, 0.0);
        std::fill_n(bound.missing, kernel_->levels[0].shares, 0.0);
    }

    int stand_still() {
        std::fill_n(kernel_->bound.v, kernel_->model().joints.size(), 0.0);
        return STANDS;
    }

    int come_back() {
        if (!kernel_->comes_back()) return stand_still();
        return COMES_BACK + STANDS + int(kernel_->come_back());
    }

    // Whether the reading is one, and q what the last command has led to.
    bool usable() {
        if (!reading_ || !observer_) return false;
        double size = 0.0;
        bool stands = true, same = true;
        const double* q = kernel_->bound.q;
        for (std::size_t j = 0; j < kernel_->model().joints.size(); j++) {
            size += reading_[j] * reading_[j];
            stands &= commanded_[j] == 0.0;
            same &= commanded_[j] == q[j];
        }
        return std::sqrt(size) < coopqp::ENDLESS && (stands || same);
    }

    int evaluate(double t, bool learns = false) {
        const int status = int(kernel_->update(t));
        if (status) return status;
        if (learns && !kernel_->learn(*observer_, reading_, loop_offset_, observer_state_))
            return int(coopqp::Status::Unusual);
        fill(t);
        return 0;
    }

    // The rows of tasks and limits at what the kinematics are.
    void fill(double t) {
        for (auto& level : kernel_->levels) coopqp::clear(level.wish, kernel_->model().blocks);
        const auto& m = kernel_->model();
        const auto& bound = kernel_->bound;
        program_.run(t, kernel_->kinematics, m, bound.q, kernel_->levels);
        auto& limits = kernel_->limits;
        bounds_.update(m, bound.q, bound.v_last, limits.lb, limits.ub);
        twist_limits_.update(kernel_->kinematics, m, kernel_->rows(), limits.G, limits.h);
    }

    bool waits() const { return !q_now_ || *stopped_ != 0.0; }

    // As coopqp.model.state.State.advance.
    void advance() {
        const double dt = kernel_->settings().dt;
        const double* v = kernel_->bound.v;
        for (std::size_t j = 0; j < kernel_->model().joints.size(); j++) {
            q_now_[j] += dt * v[j];
            v_now_[j] = v[j];
            commanded_[j] = q_now_[j];
        }
    }

    // Without the GIL for a tick that takes long. To let go of it and take it again is 2 % of a short
    // one, and another thread may keep it for milliseconds meanwhile.
    struct Unlocked {
        explicit Unlocked(const coopqp::Kernel& kernel) {
            if (takes_long(kernel)) released.emplace();
        }
        std::optional<nb::gil_scoped_release> released;
    };
    static bool takes_long(const coopqp::Kernel& kernel) {
        return kernel.model().blocks > 8;  // of joints
    }

    // One thread at a time: another is told so. Each has the GIL where it begins and ends, so that the
    // processor need not do both at once.
    struct Use {
        explicit Use(Engine& engine) : engine(engine), alone(!engine.busy_) {
            if (alone) engine.busy_ = true;
        }
        ~Use() {
            if (alone) engine.busy_ = false;
        }
        Engine& engine;
        bool alone;
    };

    // Also where they are no numbers.
    void take_bounds(const double* least, const double* most) {
        const auto& joints = kernel_->model().joints;
        auto& limits = kernel_->limits;
        for (std::size_t j = 0; j < joints.size(); j++) {
            double &lb = limits.lb[joints[j].lane], &ub = limits.ub[joints[j].lane];
            if (!(least[j] <= lb)) lb = least[j];
            if (!(most[j] >= ub)) ub = most[j];
        }
    }

    void take_limits() {
        const FilledLimits& f = filled_limits_;
        const auto& joints = kernel_->model().joints;
        const std::size_t n = joints.size(), stride = std::size_t(kernel_->stride());
        take_bounds(f.lb, f.ub);
        auto& limits = kernel_->limits;
        const std::size_t first = limits.h.size() - f.rows;
        for (std::size_t i = 0; i < f.rows; i++) {
            limits.h[first + i] = f.h[i];
            for (std::size_t j = 0; j < n; j++)
                limits.G[(first + i) * stride + std::size_t(joints[j].lane)] = f.G[i * n + j];
        }
    }

    void take_rows(const Filled& rows) {
        auto& level = kernel_->levels[std::size_t(rows.level)];
        const auto& joints = kernel_->model().joints;
        const std::size_t n = joints.size(), stride = std::size_t(kernel_->stride());
        if (rows.joints) {
            for (std::size_t j = 0; j < n; j++)
                level.wish[joints[j].lane] +=
                    rows.weight * (rows.rate[j] - rows.gain * rows.e[j]);
            return;
        }
        for (std::size_t s = 0; s < std::size_t(rows.rows); s++) {
            const std::size_t to = std::size_t(rows.at) + s;
            level.e[to] = rows.e[s];
            level.rate[to] = rows.rate[s];
            for (std::size_t j = 0; j < n; j++)
                level.J[to * stride + std::size_t(joints[j].lane)] = rows.J[s * n + j];
        }
    }

    static constexpr double NEIGHBOUR = 4.4e-16;  // of joints, as a share of themselves

    std::unique_ptr<coopqp::Kernel> kernel_;
    std::vector<double> kept_, answer_, after_, beside_;
    bool doubtful_ = false;  // whether neighbours have another answer
    std::optional<coopqp::ResolvedRate> resolved_rate_;
    coopqp::Program program_;
    coopqp::Bounds bounds_;
    bool busy_ = false;
    coopqp::TwistLimits twist_limits_;
    FilledLimits filled_limits_{};
    std::vector<Filled> filled_;
    nb::object state_, limits_, measured_, read_, observing_;
    std::unique_ptr<coopqp::LoopObserver> observer_;
    const double* reading_ = nullptr;
    double *loop_offset_ = nullptr, *observer_state_ = nullptr;
    nb::list rows_;
    nb::dict references_;
    double *q_now_ = nullptr, *v_now_ = nullptr, *commanded_ = nullptr;
    double *stopped_ = nullptr, *J_ext_ = nullptr;
    double* memory_ = nullptr;  // all that the law remembers; kept_: before the tick
    std::optional<BoundState> owner_;
};

}  // namespace KERNEL_MODULE
