// The kernel's core on random robots and garbage, without Python: for sanitizers, and for faults
// that the check has to catch.
//
//     core SEED COUNT     prints what became of the ticks; exit code 1 where something is wrong
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <stdexcept>

#include "../../coopqp/kernel/core/bounds.hpp"
#include "../../coopqp/kernel/core/kernel.hpp"
#include "../../coopqp/kernel/core/left_singular.hpp"
#include "../../coopqp/kernel/core/program.hpp"
#include "../../coopqp/kernel/core/trajectory_evaluation.hpp"
#include "../../coopqp/kernel/core/twist_limits.hpp"

using namespace coopqp;

namespace {

using Random = std::mt19937_64;

double uniform(Random& random, double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(random);
}

int whole(Random& random, int a, int b) { return std::uniform_int_distribution<int>(a, b)(random); }

Placement somewhere(Random& random, double size) {
    Placement at;
    double w[3];
    for (int i = 0; i < 3; i++) {
        w[i] = uniform(random, -1.5, 1.5);
        at.p[i] = uniform(random, -size, size);
    }
    exp3(w, at.R);
    return at;
}

// Everything that Python would own.
struct Owner {
    std::vector<double> q, v_last, v, loop_offset, p, R, error, drift, seen, pulls, missed, scaled_pull,
        missing, recovery, chatter;
    void bind(Kernel& k, int n, int arms, int levels) {
        for (auto* a : {&q, &v_last, &v, &seen}) a->assign(std::size_t(n), 0.0);
        for (auto* a : {&loop_offset, &error, &drift}) a->assign(std::size_t(6 * (arms - 1)), 0.0);
        p.assign(3, 0.0);
        R.assign(9, 0.0);
        pulls.assign(std::size_t(levels), 0.0);
        for (auto* a : {&scaled_pull, &recovery}) a->assign(1, 0.0);
        missed.assign(std::size_t(k.levels[0].hard), 0.0);
        chatter.assign(1 + std::size_t(n), 0.0);
        missing.assign(std::size_t(k.levels[0].shares), 0.0);
        k.bound = {q.data(), v_last.data(), v.data(), loop_offset.data(), p.data(), R.data(),
                   error.data(), drift.data(), seen.data(), pulls.data(), missed.data(),
                   scaled_pull.data(), missing.data(), recovery.data(), chatter.data()};
    }

    // Have again what was remembered when it was another; where the arrays are stays.
    void remember(const Owner& other) {
        std::copy(other.pulls.begin(), other.pulls.end(), pulls.begin());
        std::copy(other.missed.begin(), other.missed.end(), missed.begin());
        scaled_pull[0] = other.scaled_pull[0];
        std::copy(other.missing.begin(), other.missing.end(), missing.begin());
        recovery[0] = other.recovery[0];
        std::copy(other.chatter.begin(), other.chatter.end(), chatter.begin());
    }
};

struct Case {
    std::unique_ptr<Kernel> kernel;
    Program program;
    Bounds bounds;
    TwistLimits twist_limits;
    Owner owner;

    Status tick(double t) {
        const Status status = kernel->update(t);
        if (status != Status::Optimal) return status;
        for (Level& level : kernel->levels) clear(level.wish, kernel->model().blocks);
        program.run(t, kernel->kinematics, kernel->model(), owner.q.data(), kernel->levels);
        Limits& limits = kernel->limits;
        bounds.update(kernel->model(), owner.q.data(), owner.v_last.data(), limits.lb, limits.ub);
        twist_limits.update(kernel->kinematics, kernel->model(), kernel->rows(), limits.G, limits.h);
        return kernel->solve(true);
    }
};

Case random_case(Random& random) {
    auto arena = std::make_unique<Arena>();
    auto model = std::make_unique<Model>();
    const int arms = whole(random, 1, 5), torso = whole(random, 0, 3) ? 0 : whole(random, 1, 2);
    for (int j = 0; j < torso; j++)
        model->joints.push_back({j - 1, whole(random, 0, 1) == 1, somewhere(random, 0.2), -1});
    for (int i = 0; i < arms; i++) {
        int parent = torso - 1;
        const int joints = whole(random, 0, 8);
        for (int j = 0; j < joints; j++) {
            model->joints.push_back({parent, whole(random, 0, 9) == 0, somewhere(random, 0.3), -1});
            parent = int(model->joints.size()) - 1;
        }
        Arm arm;
        arm.tip = parent;
        arm.at = somewhere(random, 0.1);
        arm.alpha = 1.0 / arms;
        model->arms.push_back(arm);
    }
    model->joints.push_back({-1, false, somewhere(random, 0.2), -1});  // moves no arm
    model->holding = whole(random, 1, arms);
    for (int i = 0; i < arms; i++)
        model->arms[std::size_t(i)].alpha = i < model->holding ? 1.0 / model->holding : 0.0;
    lay_out(*model, *arena);
    // The object is where arm 0 has it at zero: the other arms' frames are moved there.
    Kinematics k(*model);
    const std::size_t n = model->joints.size();
    std::vector<double> q(n);
    for (double& x : q) x = uniform(random, -1.0, 1.0);
    k.place(q.data());
    k.measure();
    for (int i = 1; i < model->holding; i++) {
        Arm& arm = model->arms[std::size_t(i)];
        double A[9], B[9], moved[3], R[9];
        const Frame &a = k.carried[0], &b = k.carried[std::size_t(i)];
        for (int r = 0; r < 3; r++) {
            A[3 * r] = a.x[r], A[3 * r + 1] = a.y[r], A[3 * r + 2] = a.z[r];
            B[3 * r] = b.x[r], B[3 * r + 1] = b.y[r], B[3 * r + 2] = b.z[r];
            moved[r] = a.p[r] - b.p[r];
        }
        double in_hand[3], turned[3], BtA[9];
        transposed_times3(B, moved, in_hand);
        times3(arm.at.R, in_hand, turned);
        for (int r = 0; r < 3; r++) arm.at.p[r] += turned[r];
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 3; c++)
                BtA[3 * r + c] = B[r] * A[c] + B[3 + r] * A[3 + c] + B[6 + r] * A[6 + c];
        product(arm.at.R, BtA, R);
        std::copy(R, R + 9, arm.at.R);
    }
    Settings s;
    s.dt = 0.01;
    s.kappa = whole(random, 0, 1) ? 100.0 : 0.0;
    s.damping = 1e-6;
    s.error_damping = 0.5;
    s.reach = 2.0;
    s.budget = {1e-6, 1e-6, 1e-6, 1.0, 1.0};
    s.lower.assign(n, -2.0);
    s.upper.assign(n, 2.0);
    s.second_order.assign(std::size_t(std::max(model->loops(), 0)) * n, 1e-4);
    s.steepest = 1e-4;
    s.relaxes = n % 2;
    TwistLimits twist_limits;
    if (whole(random, 0, 2) == 0) {
        twist_limits.limits.push_back({0, {0.05, 0.08}, {0, 4}, {}, {0, 0, 0}, 0.0, 0.0});
        twist_limits.limits.push_back({4, {}, {}, {0.05, 0.0, 0.0, 0.0, 0.05, 0.1},
                                       {0, 0, 1}, k.p_WO[2] - 0.06, 10.0});
        s.inequalities = 6;
    }
    std::vector<Level> levels;
    Program program;
    const int count = whole(random, 1, 3);
    for (int l = 0; l < count; l++) {
        Level level;
        const bool last = l == count - 1 && count > 1;
        const bool apart = !last && model->arms.size() > 1 && whole(random, 0, 5) == 0;
        const int rows = last ? 0 : apart ? 6 : whole(random, 1, 4);
        level.rows = rows;
        // The first level may be of hard rows, then scaled tasks of a row each, and then no others.
        const bool scales = l == 0 && !last && count > 1 && whole(random, 0, 2) == 0;
        if (l == 0 && !last) level.hard = std::min(whole(random, 0, 2), scales ? rows - 1 : rows);
        if (level.hard && !scales) level.hard = rows;
        level.shares = scales ? rows - level.hard : 0;
        level.exact = level.hard + level.shares;
        level.share.assign(std::size_t(rows), -1);
        for (int k = 0; k < level.shares; k++) level.share[std::size_t(level.hard + k)] = k;
        for (auto* a : {&level.e, &level.rate, &level.wanted}) a->assign(std::size_t(rows), 0.0);
        level.gain.assign(std::size_t(rows), 5.0);
        level.weight.assign(std::size_t(rows), std::pow(10.0, uniform(random, -1, 2)));
        level.curvature_bound.assign(std::size_t(rows), 1.0);
        level.asks_velocity.assign(std::size_t(rows), 0);
        level.twist.assign(std::size_t(rows), !apart);
        const std::size_t stride = std::size_t(model->blocks) * LANES;
        level.T = arena->take(8 * std::size_t(rows + 1));
        level.J = arena->take(stride * std::size_t(rows + 1));
        level.wish = arena->take(stride);
        Primitive p{};
        p.reference = Reference{};
        const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        std::copy(unit, unit + 9, p.reference.RT_0);
        p.reference.begin();
        std::copy(unit, unit + 9, p.Q_start);
        p.level = l;
        p.weight = 1.0;
        p.gain = 0.5;
        if (last) {
            level.joint_weight = 1.0;
            p.kind = n % 2 ? Kind::Centering : Kind::Manipulability;
            p.numbers.assign(2 * n, 0.1);
            p.rows = {0, 2};
            p.length = 0.1;
        } else if (apart) {
            p.kind = Kind::Relative;
            p.numbers.assign(1, double(whole(random, 0, int(model->arms.size()) - 2)));
            p.rows = {0, 1, 2, 3, 4, 5};
        } else {
            p.kind = Kind::Twist;
            for (int r = 0; r < rows; r++) p.rows.push_back((r + l) % 6);
            for (double& x : p.velocity) x = uniform(random, -0.3, 0.3);
        }
        program.primitives.push_back(p);
        levels.push_back(level);
    }
    program.open(*model, *arena);
    std::vector<std::vector<int>> kept(std::size_t(std::max(model->loops(), 0)),
                                       {0, 1, 2, 3, 4, 5});
    Case made;
    const int arms_in_all = arms;
    made.program = program;
    made.bounds = Bounds(n, s.dt);
    made.bounds.lower.assign(n, whole(random, 0, 1) ? -0.3 : -3.0);
    made.bounds.upper.assign(n, whole(random, 0, 1) ? 0.2 : 3.0);
    const bool brakes = whole(random, 0, 2) == 0;
    const std::vector<double> step(n, 0.05);
    const int outside = whole(random, 0, 2) ? 0 : whole(random, 1, 3);  // joints, at most
    for (int i = 0; i < outside; i++) {
        const std::size_t j = std::size_t(whole(random, 0, int(n) - 1));
        const double by = std::pow(10.0, uniform(random, -6, -1));
        if (whole(random, 0, 1))
            s.lower[j] = q[j] + by;
        else
            s.upper[j] = q[j] - by;
        if (s.lower[j] > s.upper[j]) s.lower[j] = -2.0;
    }
    made.bounds.take({Bounded::Position, s.lower, s.upper, {}, 0.5});
    if (brakes) made.bounds.take({Bounded::Braking, s.lower, s.upper, step, 0.0});
    made.twist_limits = twist_limits;
    made.kernel = std::make_unique<Kernel>(std::move(arena), std::move(model), kept, s,
                                           std::move(levels));
    made.owner.bind(*made.kernel, int(n), arms_in_all, count);
    made.owner.q = q;
    made.kernel->bound.q = made.owner.q.data();
    return made;
}

int garbage(Random& random, Case& c) {
    const double bad[] = {std::numeric_limits<double>::quiet_NaN(),
                          std::numeric_limits<double>::infinity(), 1e308, -1e200};
    int optimal = 0;
    for (double x : bad) {
        Owner kept = c.owner;
        auto& into = whole(random, 0, 1) ? c.owner.q : c.owner.v_last;
        into[std::size_t(whole(random, 0, int(into.size()) - 1))] = x;
        const Status status = c.tick(0.0);
        if (status == Status::Optimal)
            for (double v : c.owner.v) optimal += !std::isfinite(v);
        std::copy(kept.q.begin(), kept.q.end(), c.owner.q.begin());
        std::copy(kept.v_last.begin(), kept.v_last.end(), c.owner.v_last.begin());
    }
    return optimal;
}

// How often the observer of the loop-closure offset, given anything as measured joints, moves what is
// Python's, keeps what was to be forgotten, or learns no number.
int wrong_observer(Random& random, Case& c) {
    const std::size_t n = c.owner.q.size(), loops = c.owner.loop_offset.size(), arms = loops / 6 + 1;
    std::vector<double> sag(n), torque(n), opened(loops), told(3), observer_state(2 + loops),
        compliance(n * n), at_origin(18 * arms), left(3 * loops), stalled(2 * loops / 3);
    double spent = 0.0;
    for (std::size_t j = 0; j < n; j++) compliance[j * n + j] = uniform(random, 0.0, 0.02);
    for (double& x : at_origin) x = uniform(random, -1.0, 1.0);
    LoopObserver observer(c.kernel->model(),
                          {{0, 0, 1}, at_origin, 0.01, 0.05, {0.02, 0.2}, whole(random, 1, 3),
                           whole(random, 0, 1) == 1, compliance.data(), sag.data(), torque.data(),
                           opened.data(), told.data(), left.data(), stalled.data(), &spent, 2.0,
                           std::vector<double>(n, whole(random, 0, 1) * 5e-4)});
    if (c.kernel->update(0.0) != Status::Optimal) return 0;
    int wrong = 0;
    for (double bad : {0.0, 0.0, 0.0, std::numeric_limits<double>::quiet_NaN(), 1e200, 0.0}) {
        const auto offset = c.owner.loop_offset, before = observer_state;
        std::vector<double> reading = c.owner.q;
        for (double& x : reading) x += uniform(random, -1e-3, 1e-3);
        reading[std::size_t(whole(random, 0, int(n) - 1))] += bad;
        observer.begin();
        const bool learnt = c.kernel->learn(observer, reading.data(), c.owner.loop_offset.data(),
                                            observer_state.data());
        if (learnt && bad == 0.0)
            for (double x : c.owner.loop_offset) wrong += !std::isfinite(x);
        if (!learnt || bad != 0.0 || whole(random, 0, 1)) {
            observer.forget();
            wrong += c.owner.loop_offset != offset || observer_state != before;
        }
    }
    std::fill(c.owner.loop_offset.begin(), c.owner.loop_offset.end(), 0.0);
    return wrong;
}

// How many products of left singular vectors are no identity's, by the columns of a random matrix of
// which some depend on others.
int wrong_directions(Random& random) {
    const int n = whole(random, 1, 12), m = whole(random, 1, 14);
    std::vector<double> A(std::size_t(n * m)), U(std::size_t(n * n)), values(std::size_t(m), 0.0);
    for (double& x : A) x = whole(random, -2, 2);
    left_singular(A.data(), n, m, 1e-3, values.data(), U.data());
    int wrong = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double product = 0.0;
            for (int k = 0; k < n; k++) product += U[std::size_t(k * n + i)] * U[std::size_t(k * n + j)];
            wrong += !(std::fabs(product - (i == j)) < 1e-12);
        }
    for (int k = 1; k < m; k++) wrong += !(values[std::size_t(k)] <= values[std::size_t(k - 1)]);
    return wrong;
}

// How many sines and cosines are off by more than two units of the last digit of 1.
int wrong_sines(Random& random) {
    int wrong = 0;
    for (double size : {1e-8, 1.0, 7.0, 100.0, MOST_TURNED, 1e9}) {
        for (int k = 0; k < 500; k++) {
            alignas(32) double angles[LANES], sine[LANES], cosine[LANES];
            for (double& x : angles) x = uniform(random, -size, size);
            if (k % 4 == 0) angles[0] = PI / 4 * std::nearbyint(angles[0] / (PI / 4));
            sines(angles, 1, sine, cosine);
            for (int i = 0; i < LANES; i++) {
                const long double x = angles[i];
                wrong += !(std::fabs(double(sine[i] - std::sin(x))) <= 2 * 0x1p-53);
                wrong += !(std::fabs(double(cosine[i] - std::cos(x))) <= 2 * 0x1p-53);
            }
        }
    }
    return wrong;
}

// How many numbers of a survey are wrong: J v of the object's place against differences of it, and a
// point of the world.
int wrong_survey(Random& random) {
    auto arena = std::make_unique<Arena>();
    auto model = std::make_unique<Model>();
    for (int i = 0; i < 2; i++) {
        int parent = -1;
        for (int left = whole(random, 1, 5); left > 0; left--) {
            model->joints.push_back({parent, whole(random, 0, 3) == 0, somewhere(random, 0.3), -1});
            parent = int(model->joints.size()) - 1;
        }
        Arm arm;
        arm.tip = parent;
        arm.at = somewhere(random, 0.1);
        arm.alpha = i ? 0.75 : 0.25;
        model->arms.push_back(arm);
    }
    model->holding = 2;
    lay_out(*model, *arena);
    const std::size_t n = model->joints.size(), rows = 3, points = 2;
    Level level;
    for (auto* a : {&level.e, &level.rate}) a->assign(rows, 0.0);
    level.twist.assign(rows, 1);
    level.T = arena->take(8 * (rows + 1));
    Primitive p{};
    p.kind = Kind::Twist;
    p.rows = {0, 1, 2};
    constexpr double STEP = 1e-5;
    std::vector<double> q(3 * n), v(2 * n), t(3);
    for (std::size_t j = 0; j < n; j++) {
        q[n + j] = uniform(random, -1.0, 1.0);
        v[j] = v[n + j] = uniform(random, -1.0, 1.0);
        q[j] = q[n + j] - STEP * v[j];
        q[2 * n + j] = q[n + j] + STEP * v[j];
    }
    std::vector<double> e(3 * rows), rate(3 * rows), moved(2 * rows), p_WO(9), R_WO(27), loops(18);
    std::vector<double> at(9 * points);
    TrajectoryEvaluation survey(std::move(arena), std::move(model), {level}, {p},
                  {{-1, {1.0, 2.0, 3.0}}, {int(n) - 1, {0.1, 0.0, 0.0}}});
    survey.look(3, t.data(), q.data(), v.data(),
                {e.data(), rate.data(), moved.data(), p_WO.data(), R_WO.data(), loops.data(), at.data()});
    int wrong = 0;
    for (std::size_t r = 0; r < 3; r++) {
        const double found = (p_WO[6 + r] - p_WO[r]) / (2 * STEP);
        wrong += !(std::fabs(moved[rows + r] - found) < 1e-6);
        wrong += at[6 * points + r] != 1.0 + double(r);
    }
    return wrong;
}

Convex random_body(Random& random) {
    Convex body;
    std::vector<std::pair<int, int>> edges;
    body.half = {uniform(random, 0.02, 0.1), uniform(random, 0.02, 0.1), uniform(random, 0.02, 0.1)};
    body.form = Form(whole(random, 0, 3));
    if (body.form == Form::Cylinder) body.half.y = body.half.x;
    if (body.form == Form::Hull) body.rim = whole(random, 0, 1) ? 0.0 : 0.03;
    const int rings = body.form == Form::Hull ? whole(random, 1, 6) : 2, around = 4;
    for (int i = 0; i < rings; i++)  // of an ellipsoid, so that all are corners
        for (int k = 0; k < around; k++) {
            const double up = (i + 0.5) * PI / rings, turn = (k + 0.5 * (i % 2)) * 2.0 * PI / around;
            body.points.push_back({body.half.x * std::sin(up) * std::cos(turn),
                                   body.half.y * std::sin(up) * std::sin(turn),
                                   body.half.z * std::cos(up)});
        }
    const int count = int(body.points.size());
    for (int i = 0; i < count; i++)  // more than a hull has do no harm
        for (int k = i + 1; k < count; k++) edges.emplace_back(i, k);
    body.radius = std::sqrt(dot(body.half, body.half)) + body.rim;
    body.half = body.half + V3{body.rim, body.rim, body.rim};
    body.open(edges);
    return body;
}

// How many pairs of bodies come together faster than may be, at speeds that keep all rows there are.
int too_fast(Random& random, int& near) {
    auto arena = std::make_unique<Arena>();
    Model model;
    std::vector<Solid> solids;
    const std::size_t arms = 2, joints = 3, n = arms * joints;
    for (std::size_t i = 0; i < arms; i++) {
        Arm arm;
        for (std::size_t j = 0; j < joints; j++) {
            const int parent = j ? int(model.joints.size()) - 1 : -1;
            model.joints.push_back({parent, whole(random, 0, 3) == 0, somewhere(random, 0.3), -1});
            arm.tip = int(model.joints.size()) - 1;
            Solid solid{arm.tip, somewhere(random, 0.1), random_body(random), std::vector<double>(n)};
            for (int k = arm.tip; k >= 0; k = model.joints[std::size_t(k)].parent)
                solid.max_point_speeds[std::size_t(k)] = 3.0;
            solids.push_back(solid);
        }
        arm.at = somewhere(random, 0.1);
        arm.alpha = 0.5;
        model.arms.push_back(arm);
    }
    model.holding = int(arms);
    lay_out(model, *arena);
    std::vector<std::pair<int, int>> pairs;
    for (int a = 0; a < int(n); a++)
        for (int b = a + 1; b < int(n); b++) pairs.emplace_back(a, b);
    const double distance = 0.01, gain = 10.0, within = uniform(random, 0.02, 0.1), dt = 0.01;
    const std::vector<KeptApart> kept = {{Apart(solids, pairs), distance}};
    Separation separation(model, kept[0], gain, within, dt);
    Limits limits(model.blocks * LANES, 0, separation.most_rows(), *arena);
    Kinematics kinematics(model);
    std::vector<double> q(n), speed(n);
    double* v = arena->take(std::size_t(model.blocks) * LANES);
    for (std::size_t j = 0; j < n; j++) {
        q[j] = uniform(random, -1.0, 1.0);
        speed[j] = 0.1;
        v[model.joints[j].lane] = uniform(random, -1.0, 1.0);
    }
    kinematics.place(q.data());
    if (separation.begin(kinematics, speed.data(), limits, true) != Separation::Told::Kept) return 0;
    std::fill(speed.begin(), speed.end(), 1.0);
    if (separation.look(kinematics, speed.data(), v, limits) == Separation::Told::Unknown) return 0;
    near += int(separation.near());
    double share = 1.0;
    for (std::size_t i = 0; i < limits.h.size(); i++) {
        const double closes = dot(limits.G + i * std::size_t(model.blocks) * LANES, v, model.blocks);
        if (closes > limits.h[i]) share = std::min(share, std::max(limits.h[i], 0.0) / closes);
    }
    const double step = 1e-6;
    std::vector<double> then = q, before, after;
    for (std::size_t j = 0; j < n; j++) then[j] += step * share * v[model.joints[j].lane];
    FreeSpace space(model, kept);
    space.measure(q.data(), [&](const Closest& c) { before.push_back(c.gap <= KNOWN ? c.d : 0.0); });
    space.measure(then.data(), [&](const Closest& c) { after.push_back(c.gap <= KNOWN ? c.d : 1.0); });
    int wrong = 0;
    for (std::size_t k = 0; k < pairs.size(); k++) {
        const double d = before[k], far = std::max(d - within, 0.0) * (1.0 / dt - gain);
        if (d <= distance) continue;
        wrong += (d - after[k]) / step > gain * (d - distance) + far + 1e-3;
    }
    for (double& x : q) x = std::numeric_limits<double>::quiet_NaN();
    return wrong + space.free(q.data());
}

}  // namespace

int main(int count, char** given) {
    const unsigned long seed = count > 1 ? std::strtoul(given[1], nullptr, 10) : 0;
    const int cases = count > 2 ? std::atoi(given[2]) : 200;
    int optimal = 0, ticks = 0, faults = 0, elsewhere = 0, missed = 0, proofs = 0, back = 0;
    Random angles(seed);
    int wrong = wrong_sines(angles), near = 0;
    for (int i = 0; i < std::max(cases, 100); i++) wrong += too_fast(angles, near);
    wrong += near == 0;
    for (int i = 0; i < cases; i++) {
        Random random(seed + (unsigned long)i);
        Case c;
        try {
            c = random_case(random);
        } catch (const std::invalid_argument&) {
            continue;  // what Python does not hand to the kernel
        }
        for (int k = 0; k < 20; k++) {
            const Status status = c.tick(0.01 * k);
            ticks++;
            const bool done = status == Status::Optimal || status == Status::Shortened;
            optimal += done;
            proofs += status == Status::Infeasible;
            if (!done) break;
            back += c.kernel->comes_back();
            for (std::size_t j = 0; j < c.owner.q.size(); j++) {
                wrong += !std::isfinite(c.owner.v[j]);
                wrong += c.owner.v[j] < c.bounds.lower[j] || c.owner.v[j] > c.bounds.upper[j];
                // Who is outside does not go farther out.
                wrong += c.kernel->settings().outside(c.owner.q.data(), int(j)) * c.owner.v[j] < 0.0;
                c.owner.q[j] += 0.01 * c.owner.v[j];
                c.owner.v_last[j] = c.owner.v[j];
            }
#ifdef COOPQP_FAULTS
            const Owner before = c.owner;
            const Status well = c.tick(0.01 * k + 0.01);
            proofs += well == Status::Infeasible;
            if (well != Status::Optimal) break;
            const std::vector<double> right = c.owner.v;
            const double leaves = c.kernel->leaves();
            for (int kind = 1; kind <= 2 * int(Fault::FalseProof); kind++) {
                const Fault wrongly = Fault((kind - 1) % int(Fault::FalseProof) + 1);
                in_limit_recovery_alone = kind > int(Fault::FalseProof);
                if (in_limit_recovery_alone && !c.kernel->comes_back()) break;
                if (wrongly == Fault::StaleFactor) {  // leave the factor of another pose
                    for (double& x : c.owner.q) x += 0.02;
                    (void)c.tick(0.0);
                    for (double& x : c.owner.q) x -= 0.02;
                }
                c.owner.remember(before);
                injected = wrongly;
                const Status seen = c.tick(0.01 * k + 0.01);
                injected = Fault::None;
                double off = 0.0;
                for (std::size_t j = 0; j < right.size(); j++)
                    off = std::max(off, std::fabs(c.owner.v[j] - right[j]));
                // Scaled tasks left their directions instead, or did not, and say so: shares had no
                // answer that holds.
                const bool otherwise = std::fabs(leaves - c.kernel->leaves()) > 1e-6;
                elsewhere += seen == Status::Optimal && otherwise;
                const bool passes = seen == Status::Optimal && !otherwise;
                faults += !passes;
                // What is feasible must not be called infeasible, whatever is wrong inside.
                if (seen == Status::Infeasible) {
                    missed++;
                    std::printf("seed %lu tick %d fault %d proves what is not so\n",
                                seed + (unsigned long)i, k, kind);
                }
                if (passes && off > 2e-6) {
                    missed++;
                    std::printf("seed %lu tick %d fault %d passes, off by %g\n", seed + (unsigned long)i,
                                k, kind, off);
                }
            }
            c.owner.remember(before);
#endif
        }
        wrong += garbage(random, c) + wrong_survey(random);
        wrong += wrong_observer(random, c) + wrong_directions(random);
    }
    std::printf("%d ticks, %d optimal, %d of them with joints coming back, %d proved infeasible, "
                "%d wrong, %d faults caught, %d of them by scaled tasks that leave their directions, "
                "%d missed\n",
                ticks, optimal, back, proofs, wrong, faults, elsewhere, missed);
    return wrong || missed || optimal == 0 || back == 0;
}
