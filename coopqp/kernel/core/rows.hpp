// Rows of tasks, of the object's twist or of all joints, times velocities and multipliers.
#pragma once
#include <vector>

#include "kinematics.hpp"
#include "problem.hpp"

namespace coopqp {

class Rows {
  public:
    explicit Rows(const Model& model) : m_(model) {}

    // Twist of the object as carried by an arm, J_i v, shape (6,).
    void twist(int arm, const double* v, double* V) const {
        const Arm& a = m_.arms[std::size_t(arm)];
        for (int r = 0; r < 6; r++) {
            V[r] = dot(m_.J_base(arm, r), v, m_.base_blocks);
            if (a.own_blocks) V[r] += dot(m_.J_own(arm, r), v + a.first, a.own_blocks);
        }
    }

    // t += factor J_i' tau
    void pull(int arm, const double* tau, double factor, double* t) const {
        const Arm& a = m_.arms[std::size_t(arm)];
        double by[6];
        for (int r = 0; r < 6; r++) by[r] = factor * tau[r];
        add_six(t, m_.J_base(arm, 0), by, m_.base_blocks);
        if (a.own_blocks) add_six(t + a.first, m_.J_own(arm, 0), by, a.own_blocks);
    }

    // J v of a level's rows from `first` to `last`; V is the object's twist at v.
    void times(const Level& level, int first, int last, const double* v, const double* V,
               double* out) const {
        for (int s = first; s < last; s++) out[s] = times(level, s, v, V);
    }

    double times(const Level& level, int s, const double* v, const double* V) const {
        if (!level.twist[std::size_t(s)])
            return dot(level.J + std::size_t(s) * stride(), v, m_.blocks);
        const double* T = level.T + 8 * s;
        double x = 0.0;
        for (int r = 0; r < 6; r++) x += T[r] * V[r];
        return x;
    }

    // The same of all arms that hold the object or have a share in where it is, shape (arms, 6).
    void twists(const double* v, double* of_arms) const {
        for (std::size_t i = 0; i < m_.arms.size(); i++)
            if (int(i) < m_.holding || m_.arms[i].alpha != 0.0) twist(int(i), v, of_arms + 6 * i);
    }

    // The object's twist, mean over the arms, of which each has its own.
    void mean(const double* of_arms, double* V) const {
        for (int r = 0; r < 6; r++) V[r] = 0.0;
        for (std::size_t i = 0; i < m_.arms.size(); i++) {
            const double alpha = m_.arms[i].alpha;
            if (alpha == 0.0) continue;
            for (int r = 0; r < 6; r++) V[r] += alpha * of_arms[6 * i + std::size_t(r)];
        }
    }

    // The object's twist at v.
    void object_twist(const double* v, double* V) const {
        double of_arm[6];
        for (int r = 0; r < 6; r++) V[r] = 0.0;
        for (std::size_t i = 0; i < m_.arms.size(); i++) {
            const double alpha = m_.arms[i].alpha;
            if (alpha == 0.0) continue;
            twist(int(i), v, of_arm);
            for (int r = 0; r < 6; r++) V[r] += alpha * of_arm[r];
        }
    }

    // One row times a multiplier: into tau where the row sees the twist, else into t.
    void pull_row(const Level& level, int s, double by, double* tau, double* t) const {
        if (!level.twist[std::size_t(s)]) {
            add(t, level.J + std::size_t(s) * stride(), by, m_.blocks);
            return;
        }
        for (int r = 0; r < 6; r++) tau[r] += by * level.T[8 * s + r];
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
            double tau[6] = {0, 0, 0, 0, 0, 0};
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
