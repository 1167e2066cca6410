// What Python says of a problem, as what the core is built of.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <memory>
#include <vector>

#include "core/apart.hpp"
#include "core/bounds.hpp"
#include "core/kernel.hpp"
#include "core/program.hpp"
#include "core/twist_limits.hpp"

namespace nb = nanobind;

namespace KERNEL_MODULE {

using Numbers = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Written = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<std::int32_t, nb::c_contig, nb::device::cpu>;
using Said = nb::ndarray<std::uint8_t, nb::c_contig, nb::device::cpu>;

std::vector<double> numbers(const nb::dict& from, const char* key) {
    const auto array = nb::cast<Numbers>(from[key]);
    return {array.data(), array.data() + array.size()};
}

std::vector<int> integers(const nb::dict& from, const char* key) {
    std::vector<int> found;
    for (double x : numbers(from, key)) found.push_back(int(x));
    return found;
}

std::vector<std::pair<int, int>> pairs_of(const std::vector<int>& flat) {
    std::vector<std::pair<int, int>> pairs;
    for (std::size_t i = 0; i + 1 < flat.size(); i += 2) pairs.emplace_back(flat[i], flat[i + 1]);
    return pairs;
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

// Which of each loop's six rows are independent, from a flag for each.
std::vector<std::vector<int>> kept_of(const std::vector<double>& flags) {
    std::vector<std::vector<int>> kept(flags.size() / 6);
    for (std::size_t i = 0; i < flags.size(); i++)
        if (flags[i] != 0.0) kept[i / 6].push_back(int(i % 6));
    return kept;
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
    s.relaxes = number(d, "relaxes") != 0.0;
    return s;
}

coopqp::Level level_of(const nb::dict& d, const coopqp::Model& m, coopqp::Arena& arena) {
    coopqp::Level level;
    level.gain = numbers(d, "gain");
    level.weight = numbers(d, "weight");
    level.curvature_bound = numbers(d, "curvature_bound");
    for (int x : integers(d, "asks_velocity")) level.asks_velocity.push_back(char(x));
    for (int x : integers(d, "twist")) level.twist.push_back(char(x));
    level.rows = int(level.gain.size());
    level.hard = int(number(d, "hard"));
    level.share = integers(d, "share");
    level.shares = int(number(d, "shares"));
    level.task = integers(d, "task");
    level.exact = int(number(d, "exact"));
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

std::vector<coopqp::Level> levels_of(const nb::dict& d, const coopqp::Model& m,
                                     coopqp::Arena& arena) {
    std::vector<coopqp::Level> found;
    for (nb::handle level : nb::cast<nb::list>(d["levels"]))
        found.push_back(level_of(nb::cast<nb::dict>(level), m, arena));
    return found;
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

std::vector<coopqp::Primitive> primitives_of(const nb::dict& d) {
    std::vector<coopqp::Primitive> found;
    for (nb::handle primitive : nb::cast<nb::list>(d["primitives"]))
        found.push_back(primitive_of(nb::cast<nb::dict>(primitive)));
    return found;
}

coopqp::Bounds bounds_of(const nb::list& limits, std::size_t n, double dt) {
    coopqp::Bounds bounds(n, dt);
    for (nb::handle limit : limits) {
        const auto d = nb::cast<nb::dict>(limit);
        bounds.take({static_cast<coopqp::Bounded>(int(number(d, "kind"))),
                     numbers(d, "lower"), numbers(d, "upper"), numbers(d, "step"),
                     number(d, "speed")});
    }
    return bounds;
}

coopqp::Solid solid_of(const nb::dict& d) {
    coopqp::Solid solid;
    solid.joint = int(number(d, "joint"));
    solid.at = placement(numbers(d, "placement").data());
    solid.max_point_speeds = numbers(d, "max_point_speeds");
    coopqp::Convex& convex = solid.convex;
    convex.form = static_cast<coopqp::Form>(int(number(d, "form")));
    const auto half = numbers(d, "half"), points = numbers(d, "points");
    convex.half = {half[0], half[1], half[2]};
    convex.radius = number(d, "radius");
    convex.rim = number(d, "rim");
    for (std::size_t i = 0; i + 2 < points.size(); i += 3)
        convex.points.push_back({points[i], points[i + 1], points[i + 2]});
    convex.open(pairs_of(integers(d, "edges")));
    return solid;
}

coopqp::KeptApart kept_apart_of(const nb::dict& d) {
    std::vector<coopqp::Solid> solids;
    for (nb::handle solid : nb::cast<nb::list>(d["solids"]))
        solids.push_back(solid_of(nb::cast<nb::dict>(solid)));
    return {{std::move(solids), pairs_of(integers(d, "pairs"))}, number(d, "distance")};
}

coopqp::Separation separation_of(const nb::dict& d, const coopqp::Model& model, double dt) {
    return {model, kept_apart_of(d), number(d, "gain"), number(d, "within"), dt};
}

coopqp::Observed observed_of(const nb::dict& d) {
    const auto most = numbers(d, "most");
    const auto at = [&](const char* name) { return nb::cast<Written>(d[name]).data(); };
    return {numbers(d, "up"), numbers(d, "at_origin"), number(d, "dt"), number(d, "share"),
            {most[0], most[1]}, int(number(d, "every")), number(d, "known") != 0.0,
            at("compliance"), at("sag"), at("torque"), at("opened"), at("told"),
            at("left"), at("stalled"), at("spent"), number(d, "span"), numbers(d, "band")};
}

coopqp::TwistLimit twist_limit_of(const nb::dict& d) {
    coopqp::TwistLimit limit;
    limit.at = int(number(d, "at"));
    limit.bounds = numbers(d, "bounds");
    limit.components = integers(d, "components");
    limit.points = numbers(d, "points");
    into(limit.normal, numbers(d, "normal"));
    limit.offset = number(d, "offset");
    limit.gain = number(d, "gain");
    return limit;
}

}  // namespace KERNEL_MODULE
