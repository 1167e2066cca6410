// The kernel as a Python class. Arrays are bound once; the GIL is released while it works.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <cstdlib>

#include "core/bounds.hpp"
#include "core/kernel.hpp"
#include "core/program.hpp"

namespace nb = nanobind;
using namespace nb::literals;

// Of its own name in each variant, so that two of them may be imported side by side.
namespace KERNEL_MODULE {

using Numbers = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Written = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

std::vector<double> numbers(const nb::dict& from, const char* key) {
    const auto array = nb::cast<Numbers>(from[key]);
    return {array.data(), array.data() + array.size()};
}

std::vector<int> integers(const nb::dict& from, const char* key) {
    std::vector<int> found;
    for (double x : numbers(from, key)) found.push_back(int(x));
    return found;
}

double number(const nb::dict& from, const char* key) { return nb::cast<double>(from[key]); }

coopqp::Placement placement(const double* x) {
    coopqp::Placement at;
    std::copy(x, x + 9, at.R);
    std::copy(x + 9, x + 12, at.p);
    return at;
}

std::unique_ptr<coopqp::Model> model_of(const nb::dict& d, coopqp::Arena& arena) {
    auto m = std::make_unique<coopqp::Model>();
    const auto parents = integers(d, "parents"), slides = integers(d, "slides");
    const auto places = numbers(d, "placements"), carried = numbers(d, "object_placements");
    const auto tips = integers(d, "tips");
    const auto alpha = numbers(d, "alpha");
    for (std::size_t j = 0; j < parents.size(); j++)
        m->joints.push_back({parents[j], slides[j] != 0, placement(&places[12 * j]), -1});
    for (std::size_t i = 0; i < tips.size(); i++) {
        coopqp::Arm arm;
        arm.tip = tips[i];
        arm.at = placement(&carried[12 * i]);
        arm.alpha = alpha[i];
        m->arms.push_back(arm);
    }
    m->holding = int(number(d, "holding"));
    coopqp::lay_out(*m, arena);
    return m;
}

coopqp::Settings settings_of(const nb::dict& d) {
    coopqp::Settings s;
    s.dt = number(d, "dt");
    s.kappa = number(d, "kappa");
    s.damping = number(d, "damping");
    s.error_damping = number(d, "error_damping");
    s.reach = number(d, "reach");
    const auto b = numbers(d, "budget");
    s.budget = {b[0], b[1], b[2], b[3], b[4]};
    s.lower = numbers(d, "lower");
    s.upper = numbers(d, "upper");
    s.second_order = numbers(d, "second_order");
    s.steepest = 0.0;
    for (double x : s.second_order) s.steepest = std::max(s.steepest, x);
    s.inequalities = int(number(d, "inequalities"));
    return s;
}

coopqp::Level level_of(const nb::dict& d, const coopqp::Model& m, coopqp::Arena& arena) {
    coopqp::Level level;
    level.gain = numbers(d, "gain");
    level.weight = numbers(d, "weight");
    level.lever = numbers(d, "lever");
    for (int x : integers(d, "asks_velocity")) level.asks_velocity.push_back(char(x));
    for (int x : integers(d, "twist")) level.twist.push_back(char(x));
    level.rows = int(level.gain.size());
    level.hard = int(number(d, "hard"));
    level.joint_weight = number(d, "joint_weight");
    const std::size_t k = level.gain.size(), stride = std::size_t(m.blocks) * coopqp::LANES;
    level.e.assign(k, 0.0);
    level.rate.assign(k, 0.0);
    level.wanted.assign(k, 0.0);
    level.T = arena.take(8 * (k + 1));
    level.J = arena.take(stride * (k + 1));
    level.wish = arena.take(stride);
    return level;
}

coopqp::Profile profile_of(const double* x) {
    return {static_cast<coopqp::Profile::Kind>(int(x[0])), x[1], x[2]};
}

coopqp::Reference reference_of(const std::vector<double>& x) {
    coopqp::Reference r;
    std::copy(&x[0], &x[3], r.c_0);
    std::copy(&x[3], &x[12], r.RT_0);
    std::copy(&x[12], &x[15], r.c_dot);
    std::copy(&x[15], &x[18], r.turn);
    r.turning = profile_of(&x[18]);
    r.turns = x[21] != 0.0;
    r.moves = r.turns || x[12] != 0.0 || x[13] != 0.0 || x[14] != 0.0;
    r.begin();
    return r;
}

void into(double* to, const std::vector<double>& from) {
    std::copy(from.begin(), from.end(), to);
}

coopqp::Primitive primitive_of(const nb::dict& d) {
    coopqp::Primitive p;
    p.kind = static_cast<coopqp::Kind>(int(number(d, "kind")));
    p.level = int(number(d, "level"));
    p.at = int(number(d, "at"));
    p.rows = integers(d, "rows");
    p.reference = reference_of(numbers(d, "reference"));
    p.profile = profile_of(numbers(d, "profile").data());
    into(p.p_O, numbers(d, "point"));
    into(p.a_O, numbers(d, "axis"));
    into(p.e_start, numbers(d, "e_start"));
    into(p.phi, numbers(d, "phi"));
    into(p.Q_start, numbers(d, "Q_start"));
    into(p.velocity, numbers(d, "velocity"));
    p.length = number(d, "length");
    p.planar = number(d, "planar") != 0.0;
    p.weight = number(d, "weight");
    p.gain = number(d, "gain");
    p.numbers = numbers(d, "numbers");
    return p;
}

coopqp::Bounds bounds_of(const nb::list& limits, std::size_t n, double dt) {
    coopqp::Bounds bounds;
    bounds.lower.assign(n, -1e300);
    bounds.upper.assign(n, 1e300);
    for (nb::handle limit : limits) {
        const auto d = nb::cast<nb::dict>(limit);
        const auto lower = numbers(d, "lower"), upper = numbers(d, "upper");
        if (number(d, "position") != 0.0) {
            bounds.positions.push_back(
                {lower, upper, 1.0 / dt, number(d, "recovery_speed"), coopqp::OUTSIDE / dt});
            continue;
        }
        for (std::size_t j = 0; j < n; j++) {
            bounds.lower[j] = std::max(bounds.lower[j], lower[j]);
            bounds.upper[j] = std::min(bounds.upper[j], upper[j]);
        }
    }
    return bounds;
}

// Rows that Python fills, and where they go.
struct Filled {
    const double *e, *J, *rate;
    int level, at, rows;
    double weight, gain;  // of joint objectives
    bool joints;
};

class Engine {
  public:
    explicit Engine(const nb::dict& d) {
        auto arena = std::make_unique<coopqp::Arena>();
        auto model = model_of(nb::cast<nb::dict>(d["model"]), *arena);
        std::vector<coopqp::Level> levels;
        for (nb::handle level : nb::cast<nb::list>(d["levels"]))
            levels.push_back(level_of(nb::cast<nb::dict>(level), *model, *arena));
        const auto settings = settings_of(nb::cast<nb::dict>(d["settings"]));
        for (nb::handle primitive : nb::cast<nb::list>(d["primitives"])) {
            program_.primitives.push_back(primitive_of(nb::cast<nb::dict>(primitive)));
            const auto& p = program_.primitives.back();
            if (p.kind != coopqp::Kind::Posture) continue;
            const std::size_t stride = std::size_t(model->blocks) * coopqp::LANES;
            double* J = levels[std::size_t(p.level)].J + std::size_t(p.at) * stride;
            for (std::size_t i = 0; i < p.rows.size(); i++)
                J[i * stride + std::size_t(model->joints[std::size_t(p.rows[i])].lane)] = 1.0;
        }
        bounds_ = bounds_of(nb::cast<nb::list>(d["bounds"]), model->joints.size(), settings.dt);
        const auto flags = integers(d, "kept");
        std::vector<std::vector<int>> kept(flags.size() / 6);
        for (std::size_t i = 0; i < flags.size(); i++)
            if (flags[i]) kept[i / 6].push_back(int(i % 6));
        kernel_ = std::make_unique<coopqp::Kernel>(std::move(arena), std::move(model), kept,
                                                   settings, std::move(levels));
    }

    void bind_state(const Numbers& q, const Numbers& v_last, const Numbers& gap,
                    const Written& p_WO, const Written& R_WO, const Written& loop_error,
                    const Written& drift, const Written& q_seen,
                    const Written& later_pulls, const Written& hard_pull) {
        auto& b = kernel_->bound;
        b.q = q.data();
        b.v_last = v_last.data();
        b.gap = gap.data();
        b.p_WO = p_WO.data();
        b.R_WO = R_WO.data();
        b.loop_error = loop_error.data();
        b.drift = drift.data();
        b.q_seen = q_seen.data();
        b.later_pulls = later_pulls.data();
        b.hard_pull = hard_pull.data();
        state_ = nb::make_tuple(q, v_last, gap, p_WO, R_WO, loop_error, drift, q_seen, later_pulls,
                                hard_pull);
    }

    void bind_command(const Written& v) {
        kernel_->bound.v = v.data();
        command_ = nb::cast(v);
    }

    void bind_limits(const Numbers& lb, const Numbers& ub, const Numbers& G, const Numbers& h) {
        lb_ = lb.data();
        ub_ = ub.data();
        G_ = G.data();
        h_ = h.data();
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
        rows_.append(nb::make_tuple(c, RT, c_dot, omega));
    }

    // A whole tick of a problem of which Python fills nothing.
    int tick(double t) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        nb::gil_scoped_release released;
        const int status = evaluate(t);
        if (status) return status;
        bounds_.update(kernel_->model(), kernel_->bound.q, kernel_->lb, kernel_->ub);
        return int(kernel_->solve());
    }

    // The same where Python has filled limits, rows of some tasks, or what some of them follow.
    int tick_with_rows(double t) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        nb::gil_scoped_release released;
        const int status = evaluate(t);
        if (status) return status;
        for (const Filled& rows : filled_) take_rows(rows);
        if (lb_)
            take_limits();
        else
            bounds_.update(kernel_->model(), kernel_->bound.q, kernel_->lb, kernel_->ub);
        return int(kernel_->solve());
    }

    // Ticks and steps q += v dt until a tick is not optimal, from the state that is bound, on joints
    // that do as told. Written: q before each tick and at the end, v of each tick. Returns how many
    // ticks were done; signals of the process wait as long.
    int run(double t, const Written& q, const Written& v, const Written& q_now,
            const Written& v_now, int ticks) {
        const Use use(*this);
        if (!use.alone) return BUSY;
        const std::size_t n = kernel_->model().joints.size();
        if (q.size() < n * std::size_t(ticks + 1) || v.size() < n * std::size_t(ticks) ||
            q_now.data() != kernel_->bound.q || v_now.data() != kernel_->bound.v_last)
            return BUSY;
        nb::gil_scoped_release released;
        const double dt = kernel_->settings().dt;
        const double* decided = kernel_->bound.v;
        int done = 0;
        for (; done < ticks; done++) {
            std::copy(q_now.data(), q_now.data() + n, q.data() + std::size_t(done) * n);
            if (evaluate(t)) break;
            bounds_.update(kernel_->model(), kernel_->bound.q, kernel_->lb, kernel_->ub);
            if (kernel_->solve() != coopqp::Status::Optimal) break;
            for (std::size_t j = 0; j < n; j++) {
                q_now.data()[j] += dt * decided[j];
                v_now.data()[j] = v.data()[std::size_t(done) * n + j] = decided[j];
            }
            t += dt;
        }
        std::copy(q_now.data(), q_now.data() + n, q.data() + std::size_t(done) * n);
        return done;
    }

    // e, J and rate of a level's rows, one row after the other, for tests.
    std::vector<double> rows(int level) const { return kernel_->rows_of(level); }

    std::vector<double> worst() const {
        return {kernel_->check().worst_primal, kernel_->check().worst_dual};
    }

  private:
    static constexpr int BUSY = -1;

    int evaluate(double t) {
        const int status = int(kernel_->update(t));
        if (status) return status;
        for (auto& level : kernel_->levels) coopqp::clear(level.wish, kernel_->model().blocks);
        program_.run(t, kernel_->kinematics, kernel_->model(), kernel_->bound.q, kernel_->levels);
        return 0;
    }

    // One thread at a time: another is told so.
    struct Use {
        explicit Use(Engine& engine) : engine(engine), alone(!engine.busy_.test_and_set()) {}
        ~Use() {
            if (alone) engine.busy_.clear();
        }
        Engine& engine;
        bool alone;
    };

    void take_limits() {
        const auto& joints = kernel_->model().joints;
        const std::size_t n = joints.size(), stride = std::size_t(kernel_->stride());
        for (std::size_t j = 0; j < n; j++) {
            kernel_->lb[joints[j].lane] = lb_[j];
            kernel_->ub[joints[j].lane] = ub_[j];
        }
        for (std::size_t i = 0; i < kernel_->h.size(); i++) {
            kernel_->h[i] = h_[i];
            for (std::size_t j = 0; j < n; j++)
                kernel_->G[i * stride + std::size_t(joints[j].lane)] = G_[i * n + j];
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

    std::unique_ptr<coopqp::Kernel> kernel_;
    coopqp::Program program_;
    coopqp::Bounds bounds_;
    std::atomic_flag busy_ = ATOMIC_FLAG_INIT;
    const double *lb_ = nullptr, *ub_ = nullptr, *G_ = nullptr, *h_ = nullptr;
    std::vector<Filled> filled_;
    nb::object state_, command_, limits_;
    nb::list rows_;
};

}  // namespace KERNEL_MODULE

using KERNEL_MODULE::Engine;

NB_MODULE(KERNEL_MODULE, m) {
    nb::class_<Engine>(m, "Engine")
        .def(nb::init<const nb::dict&>())
        .def("bind_state", &Engine::bind_state)
        .def("bind_command", &Engine::bind_command)
        .def("bind_limits", &Engine::bind_limits)
        .def("bind_rows", &Engine::bind_rows)
        .def("bind_reference", &Engine::bind_reference)
        .def("tick", &Engine::tick)
        .def("tick_with_rows", &Engine::tick_with_rows)
        .def("run", &Engine::run)
        .def("rows", &Engine::rows)
        .def("worst", &Engine::worst);
    m.attr("sources") = KERNEL_SOURCES;  // coopqp.kernel.native.digest
    m.def("has_avx2", [] {
#if defined(__x86_64__) || defined(__i386__)
        return bool(__builtin_cpu_supports("avx2"));
#else
        return false;
#endif
    });
}
