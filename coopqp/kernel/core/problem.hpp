// What a kernel is built for: everything that does not change from tick to tick.
#pragma once
#include <algorithm>
#include <memory>
#include <vector>

#include "lanes.hpp"
#include "shared.hpp"

namespace coopqp {

struct Budget {
    double equality, bound, accuracy, loop_position, loop_orientation;
};

// The tasks of one level. Rows first those of hard and scaled tasks (of the first level), then soft
// ones.
struct Level {
    int rows = 0, hard = 0, exact = 0;  // exact: hard and scaled
    std::vector<int> share;             // of each row which share it is scaled by; -1 if by none
    int shares = 0;
    std::vector<int> task;              // the first row of each hard task
    std::vector<double> e, rate, gain, weight, curvature_bound, wanted;
    std::vector<double> aside;  // of exact rows, by the last share, which then is to be small; or none
    std::vector<char> asks_velocity, twist;
    // A row sees the object's twist (rows, 8) or, where `twist` is 0, all joints (rows, lanes).
    double *T = nullptr, *J = nullptr;
    // Joint objectives together: |v - wish|^2 with one weight for all joints.
    double joint_weight = 0.0;
    double* wish = nullptr;  // weight times the wished velocities, in lanes

    // What exact row s asks of share k, and the share that costs nothing.
    double asks(int s, int k) const {
        if (k + 1 == shares && !aside.empty()) return aside[std::size_t(s)];
        return share[std::size_t(s)] == k ? wanted[std::size_t(s)] : 0.0;
    }
    double best_share(int k) const { return k + 1 == shares && !aside.empty() ? -ASIDE : 1.0; }

    double most_weight() const {  // of hard rows
        double most = 0.0;
        for (int s = 0; s < hard; s++) most = std::max(most, weight[std::size_t(s)]);
        return most;
    }

    void want() {
        for (std::size_t s = 0; s < std::size_t(rows); s++) wanted[s] = rate[s] - gain[s] * e[s];
    }
};

struct Settings {
    double dt, kappa, damping, error_damping, reach;
    Budget budget;
    std::vector<double> lower, upper;        // position limits, beyond which a joint is outside
    std::vector<double> second_order;        // (L, n): how far v^2 opens each loop
    double steepest;                         // the largest of them
    int inequalities = 0;                    // rows of G
    bool relaxes = false;                    // hard and scaled tasks that cannot hold come near

    // Whether a joint is outside its limits: 1 below them, -1 above, 0 inside.
    int outside(const double* q, int j) const {
        const std::size_t at = std::size_t(j);
        return (q[j] < lower[at] - OUTSIDE) - (q[j] > upper[at] + OUTSIDE);
    }

    // Whether any joint is.
    bool outside(const double* q) const {
        bool any = false;
        for (std::size_t j = 0; j < lower.size(); j++)
            any |= q[j] < lower[j] - OUTSIDE || q[j] > upper[j] + OUTSIDE;
        return any;
    }
};

// Arrays that Python owns; they stay where they are while a kernel is bound to them.
struct Bound {
    const double* q = nullptr;
    const double* v_last = nullptr;
    double* v = nullptr;
    const double* loop_offset = nullptr;
    double *p_WO = nullptr, *R_WO = nullptr, *loop_error = nullptr, *drift = nullptr;
    double* q_seen = nullptr;  // the q that these belong to
    double* later_pulls = nullptr;
    double* missed = nullptr;   // what rows of hard tasks lack
    double* scaled_pull = nullptr;  // of scaled tasks at hard ones
    double* missing = nullptr;  // what each share lacks to 1
    double* recovery = nullptr;  // what the way back has pulled at the loops
    double* chatter = nullptr;    // how much more damping there is, and joints' reversals
};

}  // namespace coopqp
