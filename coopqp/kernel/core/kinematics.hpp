// Where the joints carry the object, how it moves with each arm, and how far the loops are open.
#pragma once
#include <vector>

#include "model.hpp"
#include "rotation.hpp"
#include "sines.hpp"

namespace coopqp {

struct Frame {
    v4 x, y, z, p;  // columns of R, and p; the fourth lanes are zero
};

__attribute__((always_inline)) inline Frame placed(const Frame& on, const Placement& at) {
    const double* R = at.R;
    return {on.x * R[0] + on.y * R[3] + on.z * R[6], on.x * R[1] + on.y * R[4] + on.z * R[7],
            on.x * R[2] + on.y * R[5] + on.z * R[8],
            on.p + on.x * at.p[0] + on.y * at.p[1] + on.z * at.p[2]};
}

inline Frame placed(const Placement& at) {
    const double *R = at.R, *p = at.p;
    return {v4{R[0], R[3], R[6], 0}, v4{R[1], R[4], R[7], 0}, v4{R[2], R[5], R[8], 0},
            v4{p[0], p[1], p[2], 0}};
}

// A B', row by row.
inline void relative_rotation(const Frame& A, const Frame& B, double* R) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            R[3 * i + j] = A.x[i] * B.x[j] + A.y[i] * B.y[j] + A.z[i] * B.z[j];
}

class Kinematics {
  public:
    explicit Kinematics(const Model& model)
        : carried(model.arms.size()),
          loop_error(6 * (model.arms.size() - 1)),
          model_(model),
          joints_(model.joints.size()),
          angles_(arena_.take(std::size_t(padded(model.n())))),
          sines_(arena_.take(std::size_t(padded(model.n())))),
          cosines_(arena_.take(std::size_t(padded(model.n())))) {}

    std::vector<Frame> carried;      // the object as carried by each arm
    std::vector<double> loop_error;  // as State.loop_error
    double p_WO[3], R_WO[9];

    // Of a joint, its axis turned to z.
    const Frame& joint(std::size_t j) const { return joints_[j]; }

    // Frames alone, for the look after the step.
    void place(const double* q) {
        std::copy(q, q + joints_.size(), angles_);
        sines(angles_, blocks_of(model_.n()), sines_, cosines_);
        for (std::size_t j = 0; j < joints_.size(); j++) {
            const Joint& joint = model_.joints[j];
            const Frame on =
                joint.parent < 0 ? placed(joint.at) : placed(joints_[joint.parent], joint.at);
            Frame& f = joints_[j];
            f.z = on.z;
            if (joint.slides) {
                f.x = on.x;
                f.y = on.y;
                f.p = on.p + on.z * q[j];
            } else {
                const double s = sines_[j], c = cosines_[j];
                f.x = on.x * c + on.y * s;
                f.y = on.y * c - on.x * s;
                f.p = on.p;
            }
        }
        for (std::size_t i = 0; i < carried.size(); i++) {
            const Arm& arm = model_.arms[i];
            carried[i] = arm.tip < 0 ? placed(arm.at) : placed(joints_[arm.tip], arm.at);
        }
    }

    // loop_error and the object's pose, eq. (28)-(31).
    void measure() {
        double mean[6] = {0, 0, 0, 0, 0, 0}, R[9];
        for (std::size_t i = 1; i < carried.size(); i++) {
            double* e = &loop_error[6 * (i - 1)];
            const v4 gap = carried[i].p - carried[0].p;
            for (int r = 0; r < 3; r++) e[r] = gap[r];
            relative_rotation(carried[i], carried[0], R);
            log3(R, e + 3);
            for (int r = 0; r < 6; r++) mean[r] += model_.arms[i].alpha * e[r];
        }
        const Frame& first = carried[0];
        for (int r = 0; r < 3; r++) p_WO[r] = first.p[r] + mean[r];
        double turn[9];
        exp3(mean + 3, turn);
        for (int r = 0; r < 3; r++) {
            R[3 * r] = first.x[r];
            R[3 * r + 1] = first.y[r];
            R[3 * r + 2] = first.z[r];
        }
        product(turn, R, R_WO);
    }

    // Jacobians of the object frame as carried by each arm, (v; omega) in world axes.
    void differentiate() {
        for (std::size_t i = 0; i < carried.size(); i++) {
            const Arm& arm = model_.arms[i];
            double* column = arm.columns;
            for (int j : arm.base) {
                moves(j, carried[i].p, column);
                place_column(column, arm.J_base + model_.joints[j].lane,
                             LANES * model_.base_blocks);
                column += TWIST;
            }
            for (int j : arm.own) {
                moves(j, carried[i].p, column);
                place_column(column, arm.J_own + model_.joints[j].lane - arm.first,
                             LANES * arm.own_blocks);
                column += TWIST;
            }
        }
    }

    // [J_tsk; J_rel] of eq. (31) over the joints, row by row.
    void write_jacobian(double* J) const {
        const std::size_t n = joints_.size(), arms = carried.size();
        std::fill_n(J, 6 * arms * n, 0.0);
        for (std::size_t i = 0; i < arms; i++) {
            const Arm& arm = model_.arms[i];
            const double* column = arm.columns;
            for (const auto* joints : {&arm.base, &arm.own})
                for (int j : *joints) {
                    for (std::size_t r = 0; r < 6; r++) {
                        double* to = J + r * n + std::size_t(j);
                        *to += arm.alpha * column[r];
                        if (i > 0) to[6 * i * n] += column[r];
                        for (std::size_t k = 1; i == 0 && k < arms; k++) to[6 * k * n] -= column[r];
                    }
                    column += TWIST;
                }
        }
    }

  private:
    // How a joint moves what is at p.
    void moves(int j, const v4& p, double* twist) const {
        const Frame& f = joints_[j];
        if (model_.joints[j].slides) {
            for (int r = 0; r < 3; r++) twist[r] = f.z[r];
            return;
        }
        const v4 d = p - f.p;
        twist[0] = f.z[1] * d[2] - f.z[2] * d[1];
        twist[1] = f.z[2] * d[0] - f.z[0] * d[2];
        twist[2] = f.z[0] * d[1] - f.z[1] * d[0];
        for (int r = 0; r < 3; r++) twist[3 + r] = f.z[r];
    }

    static void place_column(const double* column, double* at, int stride) {
        for (int r = 0; r < 6; r++) at[r * stride] = column[r];
    }

    const Model& model_;
    std::vector<Frame> joints_;
    Arena arena_;
    double *angles_, *sines_, *cosines_;  // of the joints, also of those that slide
};

}  // namespace coopqp
