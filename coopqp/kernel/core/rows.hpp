// Rows of tasks, of the object's twist or of all joints, times velocities and multipliers.
#pragma once
#include <vector>

#include "kinematics.hpp"
#include "problem.hpp"

namespace coopqp {

class Rows {
  public:
    explicit Rows(const Model& model) : m_(model) {}

    // Twist of the object as carried by an arm, J_i v, shape (TWIST,).
    void twist(int arm, const double* v, double* V) const {
        const Arm& a = m_.arms[std::size_t(arm)];
        const v4* column = lanes(a.columns);
        v4 first = v4{}, second = v4{};
        for (int lane : a.lanes) {
            first += column[0] * v[lane];
            second += column[1] * v[lane];
            column += 2;
        }
        lanes(V)[0] = first;
        lanes(V)[1] = second;
    }

    // t += factor J_i' tau
    void pull(int arm, const double* tau, double factor, double* t) const {
        const Arm& a = m_.arms[std::size_t(arm)];
        double by[6];
        for (int r = 0; r < 6; r++) by[r] = factor * tau[r];
        if (!a.base.empty()) add_six(t, m_.J_base(arm, 0), by, m_.base_blocks);
        if (a.own_blocks) add_six(t + a.first, m_.J_own(arm, 0), by, a.own_blocks);
    }

    // J v of a level's row; V is the object's twist at v.
    double times(const Level& level, int s, const double* v, const double* V) const {
        if (!level.twist[std::size_t(s)])
            return dot(level.J + std::size_t(s) * stride(), v, m_.blocks);
        return dot(level.T + TWIST * s, V, 2);
    }

    // The twists of all arms that hold the object or have a share in where it is, (arms, TWIST).
    void twists(const double* v, double* of_arms) const {
        for (std::size_t i = 0; i < m_.arms.size(); i++)
            if (int(i) < m_.holding || m_.arms[i].alpha != 0.0)
                twist(int(i), v, of_arms + TWIST * i);
    }

    // The object's twist, mean over the arms, of which each has its own.
    void mean(const double* of_arms, double* V) const {
        clear(V, 2);
        for (std::size_t i = 0; i < m_.arms.size(); i++)
            if (m_.arms[i].alpha != 0.0) add(V, of_arms + TWIST * i, m_.arms[i].alpha, 2);
    }

    // The object's twist at v.
    void object_twist(const double* v, double* V) const {
        alignas(64) double of_arm[TWIST];
        clear(V, 2);
        for (std::size_t i = 0; i < m_.arms.size(); i++) {
            if (m_.arms[i].alpha == 0.0) continue;
            twist(int(i), v, of_arm);
            add(V, of_arm, m_.arms[i].alpha, 2);
        }
    }

    // One row times a multiplier: into tau (TWIST,) where the row sees the twist, else into t.
    void pull_row(const Level& level, int s, double by, double* tau, double* t) const {
        if (!level.twist[std::size_t(s)]) {
            add(t, level.J + std::size_t(s) * stride(), by, m_.blocks);
            return;
        }
        add(tau, level.T + TWIST * s, by, 2);
    }

    // t += J_object' tau
    void pull_object(const double* tau, double* t) const {
        for (std::size_t i = 0; i < m_.arms.size(); i++)
            if (m_.arms[i].alpha != 0.0) pull(int(i), tau, m_.arms[i].alpha, t);
    }

    // e, J over the joints and rate of each row of a level; J is scratch, (lanes,).
    std::vector<double> listed(const Level& level, double* J) const {
        std::vector<double> found;
        for (int s = 0; s < level.rows; s++) {
            alignas(64) double tau[TWIST] = {};
            clear(J, m_.blocks);
            pull_row(level, s, 1.0, tau, J);
            pull_object(tau, J);
            found.push_back(level.e[std::size_t(s)]);
            for (const Joint& joint : m_.joints) found.push_back(J[joint.lane]);
            found.push_back(level.rate[std::size_t(s)]);
        }
        return found;
    }

    std::size_t stride() const { return std::size_t(m_.blocks) * LANES; }

  private:
    const Model& m_;
};

}  // namespace coopqp
