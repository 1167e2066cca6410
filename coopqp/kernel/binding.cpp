// The kernel as a Python class. Arrays are bound once; the GIL is released while it works.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <cstdlib>

#include "core/kernel.hpp"

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
        const auto flags = integers(d, "kept");
        std::vector<std::vector<int>> kept(flags.size() / 6);
        for (std::size_t i = 0; i < flags.size(); i++)
            if (flags[i]) kept[i / 6].push_back(int(i % 6));
        kernel_ = std::make_unique<coopqp::Kernel>(std::move(arena), std::move(model), kept,
                                                   settings_of(nb::cast<nb::dict>(d["settings"])),
                                                   std::move(levels));
    }

    void bind_state(const Numbers& q, const Numbers& v_last, const Numbers& gap,
                    const Written& p_WO, const Written& R_WO, const Written& loop_error,
                    const Written& later_pulls, const Written& hard_pull) {
        auto& b = kernel_->bound;
        b.q = q.data();
        b.v_last = v_last.data();
        b.gap = gap.data();
        b.p_WO = p_WO.data();
        b.R_WO = R_WO.data();
        b.loop_error = loop_error.data();
        b.later_pulls = later_pulls.data();
        b.hard_pull = hard_pull.data();
        state_ = nb::make_tuple(q, v_last, gap, p_WO, R_WO, loop_error, later_pulls, hard_pull);
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

    int update() {
        const Use use(*this);
        if (!use.alone) return -1;
        nb::gil_scoped_release released;
        return int(kernel_->update());
    }

    int solve() {
        const Use use(*this);
        if (!use.alone) return -1;
        nb::gil_scoped_release released;
        take_limits();
        for (auto& level : kernel_->levels) coopqp::clear(level.wish, kernel_->model().blocks);
        for (const Filled& rows : filled_) take_rows(rows);
        return int(kernel_->solve());
    }

    std::vector<double> worst() const {
        return {kernel_->check().worst_primal, kernel_->check().worst_dual};
    }

  private:
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
        .def("update", &Engine::update)
        .def("solve", &Engine::solve)
        .def("worst", &Engine::worst);
    m.def("has_avx2", [] {
#if defined(__x86_64__) || defined(__i386__)
        return bool(__builtin_cpu_supports("avx2"));
#else
        return false;
#endif
    });
}
