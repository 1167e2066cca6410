// Tasks as lists of primitives: rows over the object's twist, or over the joints.
//
// Formulas and letters are those of coopqp.model.geometry and of the tasks' own files.
#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

#include "climb.hpp"
#include "kinematics.hpp"
#include "primitive.hpp"
#include "problem.hpp"
#include "rows.hpp"
#include "shared.hpp"

namespace coopqp {

constexpr double PI = 3.14159265358979323846;
class Program {
  public:
    std::vector<Primitive> primitives;

    // Memory for what needs some.
    void open(const Model& m, Arena& arena) {
        for (const Primitive& p : primitives)
            if (p.kind == Kind::Manipulability) return climb_.open(m, arena);
    }

    // Fill all rows for time t.
    void run(double t, const Kinematics& k, const Model& m, const double* q,
             std::vector<Level>& levels) {
        for (Primitive& p : primitives) {
            Level& level = levels[std::size_t(p.level)];
            if (p.kind < Kind::Centering) p.reference.update(t);
            switch (p.kind) {
                case Kind::Point: point(p, t, k, level); break;
                case Kind::Radial: radial(p, t, k, level); break;
                case Kind::Lean: lean(p, t, k, level); break;
                case Kind::Tilt: tilt(p, t, k, level); break;
                case Kind::Rotation: rotation(p, t, k, level); break;
                case Kind::Twist: twist(p, t, k, level); break;
                case Kind::Centering: centering(p, m, q, level); break;
                case Kind::Barrier: barrier(p, m, q, level); break;
                case Kind::Posture: posture(p, t, m, q, level); break;
                case Kind::Manipulability: manipulability(p, m, level); break;
                case Kind::Relative: relative(p, t, k, m, level); break;
            }
        }
    }

  private:
    // A row that sees the velocity of a point, at `lever` from the origin, along d.
    static void along(double* T, const double* d, const double* lever) {
        for (int i = 0; i < 3; i++) T[i] = d[i];
        cross3(lever, d, T + 3);
    }

    static void about(double* T, const double* d) {
        for (int i = 0; i < 3; i++) {
            T[i] = 0.0;
            T[3 + i] = d[i];
        }
    }

    // e_r = (1 - s) e_start, as coopqp.program has it.
    static void approach(const Primitive& p, double t, int count, Level& level) {
        double share, speed;
        p.profile.at(t, share, speed);
        if (!(share < 1.0)) return;
        for (int i = 0; i < count; i++) {
            level.e[std::size_t(p.at + i)] -= p.e_start[i] * (1.0 - share);
            level.rate[std::size_t(p.at + i)] -= p.e_start[i] * speed;
        }
    }

    // Where the point is from the reference's origin: lever, gap in the world, x in its own axes.
    struct Seen {
        double lever[3], gap[3], x[3], drag[3];
    };

    static Seen see(const Primitive& p, const Kinematics& k) {
        Seen s;
        const Reference& r = p.reference;
        times3(k.R_WO, p.p_O, s.lever);
        for (int i = 0; i < 3; i++) s.gap[i] = k.p_WO[i] + s.lever[i] - r.c[i];
        times3(r.RT, s.gap, s.x);
        cross3(r.omega, s.gap, s.drag);
        for (int i = 0; i < 3; i++) s.drag[i] += r.c_dot[i];
        return s;
    }

    static void point(const Primitive& p, double t, const Kinematics& k, Level& level) {
        const Seen s = see(p, k);
        for (std::size_t i = 0; i < p.rows.size(); i++) {
            const std::size_t at = std::size_t(p.at) + i;
            const double* d = p.reference.RT + 3 * p.rows[i];
            level.e[at] = s.x[p.rows[i]];
            level.rate[at] = p.reference.moves ? dot3(d, s.drag) : 0.0;
            along(level.T + 8 * at, d, s.lever);
        }
        approach(p, t, int(p.rows.size()), level);
    }

    static void radial(const Primitive& p, double t, const Kinematics& k, Level& level) {
        const Seen s = see(p, k);
        const double z = p.planar ? 0.0 : s.x[2];
        const double away = std::hypot(std::hypot(s.x[0], s.x[1]), z);
        double u[3] = {1.0, 0.0, 0.0}, d[3];
        if (away > TINY) {
            u[0] = s.x[0] / away;
            u[1] = s.x[1] / away;
            u[2] = z / away;
        }
        transposed_times3(p.reference.RT, u, d);
        const std::size_t at = std::size_t(p.at);
        level.e[at] = away - p.length;
        level.rate[at] = p.reference.moves ? dot3(d, s.drag) : 0.0;
        along(level.T + 8 * at, d, s.lever);
        approach(p, t, 1, level);
    }

    // A unit vector by its angle from the third axis and its way from it.
    struct Polar {
        double angle, sine, way[2];
    };

    static Polar polar(const double* y) {
        Polar seen;
        seen.sine = std::hypot(y[0], y[1]);
        seen.way[0] = seen.sine > TINY ? y[0] / seen.sine : 1.0;
        seen.way[1] = seen.sine > TINY ? y[1] / seen.sine : 0.0;
        seen.angle = std::atan2(seen.sine, y[2]);
        return seen;
    }

    // As coopqp.program._lean_rows.
    static void lean(const Primitive& p, double t, const Kinematics& k, Level& level) {
        const Reference& r = p.reference;
        double share, speed, C[9], axis[3], y[3];
        p.profile.at(t, share, speed);
        std::copy(r.RT, r.RT + 9, C);
        if (share < 1.0) {
            double w[3], R[9];
            for (int i = 0; i < 3; i++) w[i] = p.phi[i] * (share - 1.0);
            exp3(w, R);
            product(R, r.RT, C);
        }
        times3(k.R_WO, p.a_O, axis);
        times3(C, axis, y);
        const Polar seen = polar(y);
        const double theta = seen.angle, u = seen.way[0], w = seen.way[1];
        static const double lowest = (PI - CONE) / std::tan(PI - CONE);
        double h = theta < 1.0 ? 1.0 : lowest;
        if (seen.sine > TINY) h = std::max(theta * std::cos(theta) / seen.sine, lowest);
        const double rest = 1.0 - h;
        const double E[2][3] = {{-rest * u * w, h + rest * u * u, -theta * w},
                                {-h - rest * w * w, rest * u * w, theta * u}};
        for (int i = 0; i < 2; i++) {
            const std::size_t at = std::size_t(p.at + i);
            double EC[3];
            transposed_times3(C, E[i], EC);
            level.e[at] = theta * seen.way[i];
            level.rate[at] = -speed * dot3(E[i], p.phi) + (r.moves ? dot3(EC, r.omega) : 0.0);
            about(level.T + 8 * at, EC);
        }
    }

    // The angle of a line to the plane of the reference's first two axes.
    static void tilt(const Primitive& p, double t, const Kinematics& k, Level& level) {
        const Reference& r = p.reference;
        double axis[3], y[3], across[3];
        times3(k.R_WO, p.a_O, axis);
        times3(r.RT, axis, y);
        const Polar seen = polar(y);
        const double aside[3] = {seen.way[1], -seen.way[0], 0.0};
        transposed_times3(r.RT, aside, across);
        const std::size_t at = std::size_t(p.at);
        level.e[at] = 0.5 * PI - seen.angle;
        level.rate[at] = dot3(across, r.omega);
        about(level.T + 8 * at, across);
        approach(p, t, 1, level);
    }

    // As coopqp.model.geometry.RotationError, whose goal is at rest.
    struct Turn {
        double e[3], left[9], turned[3];
    };

    static Turn turn(const Primitive& p, double t, const double* Q) {
        Turn found;
        double share, speed, w[3], R[9], Q_r[9], Q_e[9];
        p.profile.at(t, share, speed);
        for (int i = 0; i < 3; i++) w[i] = p.phi[i] * share;
        exp3(w, R);
        product(R, p.Q_start, Q_r);
        product_transposed(Q, Q_r, Q_e);
        log3(Q_e, found.e);
        inverse_left_jacobian(found.e, found.left);
        for (int i = 0; i < 3; i++) w[i] = p.phi[i] * speed;
        times3(Q_e, w, found.turned);
        return found;
    }

    static void rotation(const Primitive& p, double t, const Kinematics& k, Level& level) {
        const Reference& r = p.reference;
        double Q[9];
        product(r.RT, k.R_WO, Q);
        const Turn of = turn(p, t, Q);
        for (int i = 0; i < 3; i++) {
            const std::size_t at = std::size_t(p.at + i);
            double row[3];
            transposed_times3(r.RT, of.left + 3 * i, row);
            level.e[at] = of.e[i];
            level.rate[at] =
                dot3(of.left + 3 * i, of.turned) + (r.moves ? dot3(row, r.omega) : 0.0);
            about(level.T + 8 * at, row);
        }
    }

    // An arm's object frame in the first arm's; numbers: of the loop that it closes with that one.
    static void relative(const Primitive& p, double t, const Kinematics& k, const Model& m,
                         Level& level) {
        const int loop = int(p.numbers[0]), arm = loop + 1;
        const Frame &first = k.carried[0], &other = k.carried[std::size_t(arm)];
        const double* gap = &k.loop_error[std::size_t(6 * loop)];
        double RT[9], Q[9];  // R_0', R_0' R_i
        for (int j = 0; j < 3; j++) {
            RT[j] = first.x[j];
            RT[3 + j] = first.y[j];
            RT[6 + j] = first.z[j];
        }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                const v4& column = j == 0 ? other.x : j == 1 ? other.y : other.z;
                const double of_other[3] = {column[0], column[1], column[2]};
                Q[3 * i + j] = dot3(RT + 3 * i, of_other);
            }
        const Turn of = turn(p, t, Q);
        const Rows rows(m);
        const auto apart = [&](std::size_t at, const double* d, const double* w_0, bool turns) {
            double* J = level.J + at * rows.stride();
            double on_other[6] = {0, 0, 0, 0, 0, 0}, on_first[6] = {0, 0, 0, 0, 0, 0};
            for (int r = 0; r < 3; r++) {
                on_other[turns ? 3 + r : r] = d[r];
                on_first[turns ? 3 + r : r] = -d[r];
                if (w_0) on_first[3 + r] = w_0[r];
            }
            clear(J, m.blocks);
            rows.pull(arm, on_other, 1.0, J);
            rows.pull(0, on_first, 1.0, J);
        };
        for (int i = 0; i < 3; i++) {
            const std::size_t at = std::size_t(p.at + i);
            const double* d = RT + 3 * i;
            double w[3];
            cross3(d, gap, w);
            level.e[at] = dot3(d, gap) - p.reference.c[i];
            level.rate[at] = 0.0;
            apart(at, d, w, false);
            transposed_times3(RT, of.left + 3 * i, w);
            level.e[at + 3] = of.e[i];
            level.rate[at + 3] = dot3(of.left + 3 * i, of.turned);
            apart(at + 3, w, nullptr, true);
        }
        approach(p, t, 3, level);
    }

    static void twist(const Primitive& p, double t, const Kinematics& k, Level& level) {
        double share, speed, lever[3];
        p.profile.at(t, share, speed);
        times3(k.R_WO, p.p_O, lever);
        for (std::size_t i = 0; i < p.rows.size(); i++) {
            const std::size_t at = std::size_t(p.at) + i;
            const int axis = p.rows[i] % 3;
            double d[3];
            for (int j = 0; j < 3; j++)
                d[j] = p.planar ? k.R_WO[3 * j + axis] : (j == axis ? 1.0 : 0.0);
            if (p.rows[i] < 3)
                along(level.T + 8 * at, d, lever);
            else
                about(level.T + 8 * at, d);
            level.e[at] = 0.0;
            level.rate[at] = p.velocity[p.rows[i]] * share;
        }
    }

    // numbers: middles, scales.
    static void centering(const Primitive& p, const Model& m, const double* q, Level& level) {
        const std::size_t n = m.joints.size();
        for (std::size_t j = 0; j < n; j++)
            level.wish[m.joints[j].lane] -=
                p.weight * (p.gain * ((q[j] - p.numbers[j]) * p.numbers[n + j]));
    }

    // numbers: middles, 2 / range, 1 / range.
    static void barrier(const Primitive& p, const Model& m, const double* q, Level& level) {
        const std::size_t n = m.joints.size();
        for (std::size_t j = 0; j < n; j++) {
            const double x = std::min(
                std::max((q[j] - p.numbers[j]) * p.numbers[n + j], -p.length), p.length);
            const double e = x * p.numbers[2 * n + j] / (1.0 - x * x);
            level.wish[m.joints[j].lane] -= p.weight * (p.gain * e);
        }
    }

    // numbers: starts, ways; a row for each joint in `rows`, whose J is set once.
    static void posture(const Primitive& p, double t, const Model& m, const double* q,
                        Level& level) {
        double share, speed;
        p.profile.at(t, share, speed);
        const std::size_t n = m.joints.size();
        for (std::size_t i = 0; i < p.rows.size(); i++) {
            const std::size_t at = std::size_t(p.at) + i, j = std::size_t(p.rows[i]);
            level.e[at] = q[j] - p.numbers[j] - p.numbers[n + j] * share;
            level.rate[at] = p.numbers[n + j] * speed;
        }
    }

    // rows: axes of the world that count.
    void manipulability(const Primitive& p, const Model& m, Level& level) {
        add(level.wish, climb_.slope(m, p.rows, p.length), p.weight * p.gain, m.blocks);
    }

    Climb climb_;
};

}  // namespace coopqp
